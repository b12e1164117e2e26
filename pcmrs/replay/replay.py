"""Replaying a whole journal: every run of the daemon in it is decided anew and compared."""

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
from pcmrs.replay.differences import Difference, added, compared, missing, reported_already
from pcmrs.replay.history import CarryOver, DaemonRun, read_runs
from pcmrs.replay.player import JournalPlayer
from pcmrs.replay.world import ReplayCell
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
    """What a replay came to.

    Attributes:
        rows: In the journal.
        compared: Of these, what dispatchers decided.
        runs: Of the daemon.
        answered: Commands for which the journal said what came of the world; all others were decided by arguments, data
            and settings alone.
        differences: In order; empty where everything was decided as it was.
        rows_per_second: How quick it was.
    """

    journal: str
    rows: int
    compared: int
    runs: int
    answered: int
    differences: list[Difference]
    rows_per_second: float

    @property
    def is_same(self) -> bool:
        """True if every decision is the same."""
        return not self.differences


def replay(
    path: Path, clock: Clock, blueprint: Path | None = None, progress: ShowProgress | None = None
) -> ReplayReport:
    """Decide a journal anew.

    Args:
        path: The journal, or its export.
        clock: To say how quick it was.
        blueprint: The workflow to decide by, whatever the journal says; None for the one that it names, which has to be
            as it was then.
        progress: Called with rows done and all rows.

    Raises:
        ReplayError: The journal cannot be replayed by this program.
        JournalError: It cannot be read.
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
    """Decide runs of a daemon anew; see `replay`."""
    begun, heritage = clock.monotonic(), CarryOver()
    differences: list[Difference] = []
    answered, total = 0, sum(len(run.rows) for run in runs)
    for run in runs:
        workflow = workflow_of(run.tag)
        differences += heritage.begin(run, workflow)
        with asyncio.Runner(loop_factory=SimulatedLoop) as runner:
            found, asked = runner.run(_replay_run(name, run, workflow, heritage, partial(_show, progress, total)))
        answered += asked
        differences += found
        heritage.end(run, workflow)
    return ReplayReport(
        journal=name,
        rows=total,
        compared=sum(len(run.decided()) for run in runs),
        runs=len(runs),
        answered=answered,
        differences=sorted(differences, key=lambda each: each.sequence),
        rows_per_second=total / max(clock.monotonic() - begun, 1e-9),
    )


async def _replay_run(
    name: str, run: DaemonRun, workflow: AnyWorkflow, heritage: CarryOver, show: Callable[[int], None]
) -> tuple[list[Difference], int]:
    rows, cell = run.decided(), ReplayCell(_procedure_settings(name, run), run.calibration)
    access = (run.settings or {}).get("access", {})
    player = JournalPlayer(heritage.inherited(workflow), cell, rows, lease_required=bool(access.get("identity")))
    heritage.give_to(player.dispatcher, run)
    differences: list[Difference] = []
    extra = 0
    for index, stored in enumerate(rows):
        show(stored.sequence)
        await player.feed(index)
        decided = player.recorder.decided(index)
        differences += [missing(stored)] if decided is None else compared(stored, decided)
        extras = (each for each in player.recorder.extra[extra:] if not reported_already(each, rows))
        differences += [added(stored.sequence, each) for each in extras]
        extra = len(player.recorder.extra)
    await player.end()
    return differences, player.answered


def _show(progress: ShowProgress | None, total: int, done: int) -> None:
    if progress is not None and (done % SHOWN_EVERY == 0 or done == total):
        progress(done, total)


def _procedure_settings(name: str, run: DaemonRun) -> ProcedureSettings:
    """The settings of the procedure that the run wrote, or else the workflow's defaults."""
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
    """The workflows that a journal names.

    Args:
        journal: For the text of errors.
        blueprint: The one to decide by instead.
    """

    def __init__(self, journal: Path, blueprint: Path | None) -> None:
        self._journal = journal
        self._blueprint = blueprint
        self._known: dict[str, AnyWorkflow] = {}

    def of(self, tag: BlueprintTag) -> AnyWorkflow:
        """The workflow of a run. Raises `ReplayError` where it is not the one of then, and none was given."""
        if tag.id not in self._known:
            self._known[tag.id] = self._open(tag)
        workflow = self._known[tag.id]
        if self._blueprint is None and workflow.blueprint.hash != tag.hash:
            own = workflow.blueprint
            text = (
                f"{self._journal} was decided under {tag.id} {tag.version} (hash {tag.hash}); this program has "
                f"{own.version} (hash {own.hash}). Give the blueprint of then, or the one to compare, by --blueprint."
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
    """The workflow in a file; where that has no Python file beside it, with the code of the shipped one of its name.

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
