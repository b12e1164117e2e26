"""Reading a journal for its replay: the file itself or its export, cut into runs of the daemon.

What one run of the daemon leaves to the next, worked out anew: data, doubts, the latch, and what had begun.
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
from pcmrs.replay.differences import Difference
from pcmrs.replay.keys import COMPARED, is_rejected_report
from pcmrs.service.restart.state import ENDED, PersistedState, RestartState
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData


class CarryOver:
    """Follows the runs in order.

    Attributes:
        kept: What the next run begins with.
    """

    def __init__(self) -> None:
        self.kept = PersistedState()

    def begin(self, run: DaemonRun, workflow: Workflow[Cell, PlacementData]) -> Iterator[Difference]:
        """Close what the run before has begun: where this run has not done so, or closed something else.

        Args:
            run: That begins.
            workflow: That it was decided under.
        """
        closed = {
            (each.row.source or "", each.row.command_id or ""): each for each in run.rows if closes_earlier_run(each)
        }
        begun = {(each.source, each.command): each for each in self.kept.begun}
        for asked in begun.keys() - closed.keys():
            name = f"outcome {begun[asked].branch}.{begun[asked].operation}"
            yield Difference(sequence=run.rows[0].sequence, row=name, what="row", decided="unknown")
        for asked in closed.keys() - begun.keys():
            row = closed[asked].row
            name = f"outcome {row.branch}.{row.operation}"
            yield Difference(sequence=closed[asked].sequence, row=name, what="row", recorded="unknown")
        ledger = RestartState(workflow.blueprint, self.kept)
        started = [each for each in run.rows if each.row.kind == "config"][:1]
        for stored in (*started, *closed.values()):
            ledger.take(stored.row)
        self.kept = ledger.kept

    def give_to(self, dispatcher: Dispatcher[Cell, PlacementData], run: DaemonRun) -> None:
        """Have the dispatcher begin with it, as daemons do that write down how they begin."""
        if run.settings is not None:
            start = run.rows[0].sequence
            dispatcher.take_up(latched=self.kept.latched, unknown=self.kept.unknown, start=start)

    def inherited(self, workflow: Workflow[Cell, PlacementData]) -> Workflow[Cell, PlacementData]:
        """The workflow with the data that a run begins with.

        Raises:
            ReplayError: What an earlier run has left is not of the types that this program knows.
        """
        initial = workflow.initial
        kinds = {each.name: each.type for each in msgspec.structs.fields(type(initial))}
        try:
            kept = {name: msgspec.convert(value, kinds[name]) for name, value in self.kept.taken_back.items()}
        except msgspec.ValidationError as error:
            text = f"The journal holds registrations that this program cannot read: {error}."
            raise ReplayError(text) from None
        return replace(workflow, initial=msgspec.structs.replace(initial, **kept))

    def end(self, run: DaemonRun, workflow: Workflow[Cell, PlacementData]) -> None:
        """Take in what a run leaves."""
        ledger = RestartState(workflow.blueprint, self.kept)
        for stored in run.decided():
            ledger.take(stored.row)
        self.kept = ledger.kept


_SQLITE = b"SQLite format 3\0"


@dataclass(frozen=True)
class DaemonRun:
    """The rows that one run of the daemon wrote.

    Attributes:
        tag: The blueprint under which all of them were decided.
        rows: In order.
    """

    tag: BlueprintTag
    rows: list[StoredRow]

    @property
    def settings(self) -> dict[str, Any] | None:
        """The configuration as plain data; None where the run did not write it."""
        return self._started().get("settings")

    @property
    def calibration(self) -> str | None:
        """Identity of the calibrations in use; None where the run did not write it."""
        return self._started().get("calibration")

    def decided(self) -> list[StoredRow]:
        """What the dispatcher writes: neither the daemon's own rows, nor what it closed for the run before it."""
        own = (each for each in self.rows if each.row.kind in COMPARED and not closes_earlier_run(each))
        return [each for each in own if not is_rejected_report(each.row)]

    def _started(self) -> dict[str, Any]:
        """What the daemon wrote down first; empty of daemons that did not."""
        rows = (each.row for each in self.rows if each.row.kind == "config" and each.row.operation == "started")
        return next((row.result for row in rows if row.result is not None), {})


def closes_earlier_run(stored: StoredRow) -> bool:
    """Return whether the row ends what an earlier run of the daemon had begun."""
    verdict = stored.row.verdict
    reason = verdict.reason if verdict is not None else None
    return reason is not None and reason.code == ENDED.code and stored.row.states is None


def read_runs(path: Path) -> list[DaemonRun]:
    """The runs of the daemon in a journal, in order.

    Args:
        path: A journal, or its export: one row a line as JSON.

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
            text = f"{path}, line {number}: neither a journal nor the export of one: {error}."
            raise ReplayError(text, file=str(path), line=number) from None
