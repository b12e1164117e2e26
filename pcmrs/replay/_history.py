"""Runs of the daemon in a journal or its export, and the state that each passes to the next.

The state is recomputed: data, unknown outcomes, the latch, and operations in progress.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.dispatcher import Dispatcher, Workflow
from pcmrs.errors import ReplayError
from pcmrs.journal import JournalReader, StoredRow
from pcmrs.messages import BlueprintTag
from pcmrs.replay._differences import ReplayDifference
from pcmrs.replay._keys import COMPARED, is_rejected_report
from pcmrs.service.restart.state import ENDED, PersistedState, RestartState
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData


class CarryOver:
    """State that runs pass on, in order.

    Attributes:
        state: State with which the next run starts.
    """

    def __init__(self) -> None:
        self.state = PersistedState()

    def begin(self, run: DaemonRun, workflow: Workflow[Cell, PlacementData]) -> Iterator[ReplayDifference]:
        """Close the operations in progress of the run before; yield those that this run closed differently.

        Args:
            run: Run that starts.
            workflow: Workflow under which it was decided.
        """
        closed = {
            (each.row.source or "", each.row.command_id or ""): each for each in run.rows if closes_earlier_run(each)
        }
        in_flight = {(each.source, each.command): each for each in self.state.begun}
        for key in in_flight.keys() - closed.keys():
            name = f"outcome {in_flight[key].branch}.{in_flight[key].operation}"
            yield ReplayDifference(sequence=run.rows[0].sequence, row=name, what="row", decided="unknown")
        for key in closed.keys() - in_flight.keys():
            row = closed[key].row
            name = f"outcome {row.branch}.{row.operation}"
            yield ReplayDifference(sequence=closed[key].sequence, row=name, what="row", recorded="unknown")
        restart_state = RestartState(workflow.blueprint, self.state)
        started = [each for each in run.rows if each.row.kind == "config"][:1]
        for stored in (*started, *closed.values()):
            restart_state.take(stored.row)
        self.state = restart_state.kept

    def restore(self, dispatcher: Dispatcher[Cell, PlacementData], run: DaemonRun) -> None:
        """Restore the state in a dispatcher, as daemons do that journal their start.

        Args:
            dispatcher: Dispatcher of the replay.
            run: Run that starts.
        """
        if run.settings is not None:
            start = run.rows[0].sequence
            dispatcher.restore(latched=self.state.latched, unknown=self.state.unknown, start=start)

    def with_state(self, workflow: Workflow[Cell, PlacementData]) -> Workflow[Cell, PlacementData]:
        """Return the workflow with the data with which a run starts.

        Raises:
            ReplayError: Data of an earlier run do not have the types of this program.
        """
        initial = workflow.initial
        kinds = {each.name: each.type for each in msgspec.structs.fields(type(initial))}
        try:
            data = {name: msgspec.convert(value, kinds[name]) for name, value in self.state.taken_back.items()}
        except msgspec.ValidationError as error:
            text = f"The journal holds registrations that this program cannot read: {error}."
            raise ReplayError(text) from None
        return replace(workflow, initial=msgspec.structs.replace(initial, **data))

    def end(self, run: DaemonRun, workflow: Workflow[Cell, PlacementData]) -> None:
        """Apply the rows of a run to the state.

        Args:
            run: Run that ended.
            workflow: Workflow under which it was decided.
        """
        restart_state = RestartState(workflow.blueprint, self.state)
        for stored in run.decided():
            restart_state.take(stored.row)
        self.state = restart_state.kept


_SQLITE = b"SQLite format 3\0"


@dataclass(frozen=True)
class DaemonRun:
    """Rows of one run of the daemon.

    Attributes:
        tag: Blueprint under which they were decided.
        rows: Rows, in order.
    """

    tag: BlueprintTag
    rows: list[StoredRow]

    @property
    def settings(self) -> dict[str, Any] | None:
        """Configuration as plain data; None if the run did not journal it."""
        return self._started().get("settings")

    @property
    def calibration(self) -> str | None:
        """Identity of the calibrations in use; None if the run did not journal it."""
        return self._started().get("calibration")

    def decided(self) -> list[StoredRow]:
        """Return the rows of the dispatcher: without the daemon's own, and without those that close the earlier run."""
        own = (each for each in self.rows if each.row.kind in COMPARED and not closes_earlier_run(each))
        return [each for each in own if not is_rejected_report(each.row)]

    def _started(self) -> dict[str, Any]:
        """Return the data that the daemon journalled at its start; empty for daemons that did not."""
        rows = (each.row for each in self.rows if each.row.kind == "config" and each.row.operation == "started")
        return next((row.result for row in rows if row.result is not None), {})


def closes_earlier_run(stored: StoredRow) -> bool:
    """Return whether the row closes an operation of an earlier run."""
    verdict = stored.row.verdict
    reason = verdict.reason if verdict is not None else None
    return reason is not None and reason.code == ENDED.code and stored.row.states is None


def read_runs(path: Path) -> list[DaemonRun]:
    """Return the runs of the daemon in a journal, in order.

    Args:
        path: Journal, or its export with one row of JSON per line.

    Raises:
        ReplayError: There is no such file, it is neither, or rows are missing.
        JournalError: The journal cannot be read.
    """
    rows = list(_read(path))
    if not rows:
        raise ReplayError(f"{path} has no rows: there is nothing to replay.", file=str(path))
    for expected, stored in enumerate(rows, start=1):
        if stored.sequence != expected:
            text = f"{path}: row {expected} is missing; a replay needs all rows from the first on."
            raise ReplayError(text, file=str(path), sequence=expected)
    runs = (list(group) for _, group in groupby(rows, key=lambda each: each.row.session_id))
    return [DaemonRun(run[0].row.blueprint, run) for run in runs]


def _read(path: Path) -> Iterator[StoredRow]:
    try:
        with path.open("rb") as file:
            is_journal = file.read(len(_SQLITE)) == _SQLITE
    except OSError as error:
        raise ReplayError(f"{path} cannot be read: {error.strerror}.", file=str(path)) from None
    if is_journal:
        with JournalReader(path) as reader:
            yield from reader.read()
        return
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        try:
            yield msgspec.json.decode(line, type=StoredRow)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            text = f"{path}, line {number}: neither a journal nor its export: {error}."
            raise ReplayError(text, file=str(path), line=number) from None
