"""Replay of a whole journal: each run of the daemon is decided again and compared."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec

from pcmrs.clock import Clock
from pcmrs.dispatcher import Workflow
from pcmrs.errors import ConfigurationError, PcmrsError, ReplayError
from pcmrs.fsm import Blueprint, load_blueprint
from pcmrs.messages import BlueprintTag
from pcmrs.replay._differences import ReplayDifference, added, compared, missing, reported_already
from pcmrs.replay._history import CarryOver, DaemonRun, read_runs
from pcmrs.replay._player import JournalPlayer
from pcmrs.replay._world import ReplayCell
from pcmrs.settings import read_settings
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.opening import open_installed, open_workflow
from pcmrs.workflows.settings import ProcedureSettings

ShowProgress = Callable[[int, int], None]
AnyWorkflow = Workflow[Cell, PlacementData]
SHOWN_EVERY = 100
"""Rows after which progress is shown."""


class ReplayReport(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=False):
    """Result of a replay.

    Attributes:
        rows: Number of rows of the journal.
        compared: Number of rows that dispatchers decided.
        runs: Number of runs of the daemon.
        answered: Number of commands that the journal answered in place of devices; all others were decided by
            arguments, data and settings alone.
        differences: Differences, in order; empty if all decisions are the same.
        rows_per_second: Speed of the replay.
    """

    journal: str
    rows: int
    compared: int
    runs: int
    answered: int
    differences: list[ReplayDifference]
    rows_per_second: float

    @property
    def is_same(self) -> bool:
        """True if all decisions are the same."""
        return not self.differences


def replay(
    path: Path, clock: Clock, blueprint: Path | None = None, progress: ShowProgress | None = None
) -> ReplayReport:
    """Decide a journal again.

    Args:
        path: Journal, or its export.
        clock: Clock that measures the speed.
        blueprint: Blueprint to decide by; None for the workflow that the journal names, which must be unchanged.
        progress: Callback for the number of rows done, and of all rows.

    Raises:
        ReplayError: This program cannot replay the journal.
        JournalError: The journal cannot be read.
    """
    runs = read_runs(path)
    return replay_runs(str(path), runs, _Workflows(path, blueprint).of, clock, progress)


def replay_runs(
    name: str,
    runs: Sequence[DaemonRun],
    workflow_of: Callable[[BlueprintTag], AnyWorkflow],
    clock: Clock,
    progress: ShowProgress | None = None,
) -> ReplayReport:
    """Decide runs of a daemon again; see `replay`.

    Args:
        name: Name of the journal, for the report.
        runs: Runs, in order.
        workflow_of: Returns the workflow of a run.
        clock: Clock that measures the speed.
        progress: Callback for the number of rows done, and of all rows.

    Raises:
        ReplayError: This program cannot replay the runs.
    """
    started_at, carry_over = clock.monotonic(), CarryOver()
    differences: list[ReplayDifference] = []
    answered, total = 0, sum(len(run.rows) for run in runs)
    for run in runs:
        workflow = workflow_of(run.tag)
        differences += carry_over.begin(run, workflow)
        with asyncio.Runner(loop_factory=SimulatedLoop) as runner:
            found, from_journal = runner.run(
                _replay_run(name, run, workflow, carry_over, partial(_show, progress, total))
            )
        answered += from_journal
        differences += found
        carry_over.end(run, workflow)
    return ReplayReport(
        journal=name,
        rows=total,
        compared=sum(len(run.decided()) for run in runs),
        runs=len(runs),
        answered=answered,
        differences=sorted(differences, key=lambda each: each.sequence),
        rows_per_second=total / max(clock.monotonic() - started_at, 1e-9),
    )


async def _replay_run(
    name: str, run: DaemonRun, workflow: AnyWorkflow, carry_over: CarryOver, show: Callable[[int], None]
) -> tuple[list[ReplayDifference], int]:
    rows, cell = run.decided(), ReplayCell(_procedure_settings(name, run), run.calibration)
    access = (run.settings or {}).get("access", {})
    player = JournalPlayer(carry_over.with_state(workflow), cell, rows, lease_required=bool(access.get("identity")))
    carry_over.restore(player.dispatcher, run)
    differences: list[ReplayDifference] = []
    extra = 0
    try:
        for index, stored in enumerate(rows):
            show(stored.sequence)
            await player.feed(index)
            decided = player.recorder.decided(index)
            differences += [missing(stored)] if decided is None else compared(stored, decided)
            extras = (each for each in player.recorder.extra[extra:] if not reported_already(each, rows))
            differences += [added(stored.sequence, each) for each in extras]
            extra = len(player.recorder.extra)
    finally:
        await player.end()
    return differences, player.answered


def _show(progress: ShowProgress | None, total: int, done: int) -> None:
    if progress is not None and (done % SHOWN_EVERY == 0 or done == total):
        progress(done, total)


def _procedure_settings(name: str, run: DaemonRun) -> ProcedureSettings:
    """Return the procedure settings that the run journalled, or else the workflow's defaults."""
    try:
        if run.settings is None:
            return read_settings(None, [f"workflow={run.tag.id}"]).procedure
        return msgspec.convert(run.settings["procedure"], ProcedureSettings)
    except (msgspec.ValidationError, KeyError) as error:
        text = f"{name} was written with settings that this program does not know: {error}."
        raise ReplayError(text, file=name, sequence=run.rows[0].sequence) from None
    except ConfigurationError:
        return ProcedureSettings()


class _Workflows:
    """Workflows of the runs of a journal.

    Args:
        journal: Journal, for the messages.
        blueprint: Blueprint to decide by instead; None for the workflows that the journal names.
    """

    def __init__(self, journal: Path, blueprint: Path | None) -> None:
        self._journal = journal
        self._blueprint = blueprint
        self._known: dict[str, AnyWorkflow] = {}

    def of(self, tag: BlueprintTag) -> AnyWorkflow:
        """Return the workflow of a run. Raises `ReplayError` if it has changed since and no blueprint was given."""
        if tag.id not in self._known:
            self._known[tag.id] = self._open(tag)
        workflow = self._known[tag.id]
        if self._blueprint is None and workflow.blueprint.hash != tag.hash:
            own = workflow.blueprint
            text = (
                f"{self._journal} was decided under {tag.id} {tag.version} (hash {tag.hash}); this program has "
                f"{own.version} (hash {own.hash}). Give that version of the blueprint, or the one to "
                "compare, with --blueprint."
            )
            raise ReplayError(text, file=str(self._journal), version=tag.version, hash=tag.hash)
        return workflow

    def _open(self, tag: BlueprintTag) -> AnyWorkflow:
        try:
            if self._blueprint is None:
                return open_installed(tag.id)
            return with_blueprint(tag.id, self._blueprint)
        except PcmrsError as error:
            text = f"{self._journal} was decided under {tag.id} {tag.version}: {error.text}"
            raise ReplayError(text, file=str(self._journal), workflow=tag.id) from None


def with_blueprint(workflow: str, blueprint: Path) -> AnyWorkflow:
    """Return the workflow of a blueprint file; without a Python file beside it, with the code of the installed one.

    Args:
        workflow: Name of the installed workflow.
        blueprint: Blueprint file.

    Raises:
        PcmrsError: There is no such workflow, or the blueprint is unsound.
    """
    if blueprint.with_suffix(".py").exists():
        return open_workflow(str(blueprint))
    try:
        shipped = open_installed(workflow)
    except ConfigurationError:
        return open_workflow(str(blueprint))
    loaded: Blueprint = load_blueprint(blueprint)
    return replace(shipped, blueprint=loaded)
