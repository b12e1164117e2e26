"""Start of a daemon on the journal of earlier runs, and recovery of a journal that has failed."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import structlog

from pcmrs.clock import Clock
from pcmrs.dispatcher import Dispatcher, DispatcherListener, Workflow
from pcmrs.dispatcher.decisions import reason_for
from pcmrs.errors import JournalError, PcmrsError
from pcmrs.journal import Journal
from pcmrs.maintenance.migration import migration_for
from pcmrs.messages import UnknownOutcome
from pcmrs.pki import Approval, read_approval
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.settings import Settings
from pcmrs.workflows import find_workflow
from pcmrs.workflows.cell import Cell, calibration_id_of
from pcmrs.workflows.data import PlacementData


def approval_of(workflow: Workflow[Cell, PlacementData], settings: Settings, now: float) -> Approval | None:
    """Return the approval of a drafted workflow; None for a workflow that people have written.

    Args:
        workflow: The workflow.
        settings: The whole configuration.
        now: Wall time, s.

    Raises:
        ConfigurationError: A language model has drafted it, and no member of this cell has approved it as it is now.
    """
    access, cell = settings.access, settings.cell
    file = find_workflow(settings.workflow).blueprint
    members = access.members()
    return read_approval(workflow.blueprint, file, access.credentials(), members, f"{cell.site}/{cell.name}", now)


log = structlog.get_logger(__name__)

RETRY_AFTER = 1.0
"""Pause between attempts to reopen a journal that has failed, s of the machine."""


@dataclass(frozen=True, slots=True)
class Recovered:
    """Start of a run; states, connection and motion are never restored.

    Attributes:
        workflow: The workflow. Its initial data hold what explicit operations may take back.
        latched: A Stop or danger was not acknowledged, or a motion, an activity that moves the robot or a pulse had
            not ended when the last run ended.
        unknown: Unknown outcomes, until an operator has settled them.
        start: Sequence of the row of this start.
        initial_joints: Posture that was remembered last as the initial one, rad, (n,); empty for none.
    """

    workflow: Workflow[Cell, PlacementData]
    latched: bool
    unknown: tuple[UnknownOutcome, ...]
    start: int
    initial_joints: tuple[float, ...] = ()

    def give_to(self, dispatcher: Dispatcher[Cell, PlacementData], journal: Journal) -> None:
        """Start a dispatcher with it, and let it fail with its journal; before anything is submitted.

        Args:
            dispatcher: The dispatcher.
            journal: Its journal.
        """
        dispatcher.restore(latched=self.latched, unknown=self.unknown, start=self.start)
        journal.on_failure(lambda error: dispatcher.fail(reason_for(error)))

    def restore_initial_joints(self, cell: Cell) -> None:
        """Let the remembered initial posture hold in this run, too, if the settings say so and the arm has it.

        Args:
            cell: Cell of this run.
        """
        if not self.initial_joints or not cell.settings.placement.keep_initial_posture:
            return
        try:
            cell.arm.check_limits(self.initial_joints)
        except PcmrsError as error:
            log.warning("initial_posture_dropped", reason=error.text)
            return
        cell.initial_joints = list(self.initial_joints)


async def recover(
    journal: Journal,
    recorder: JournalRecorder,
    workflow: Workflow[Cell, PlacementData],
    settings: Settings,
    approval: Approval | None = None,
) -> Recovered:
    """Begin a run of the daemon on its journal: everything is checked before its first row is written.

    Args:
        journal: The journal.
        recorder: Recorder on the journal.
        workflow: The workflow.
        settings: The whole configuration.
        approval: Approval of a drafted workflow.

    Raises:
        ConfigurationError: The journal is of another version of the workflow, or a calibration cannot be used.
        JournalError: The journal cannot be read or written, or holds what this version does not know.
    """
    blueprint = workflow.blueprint
    migration = migration_for(journal.reader, blueprint, find_workflow(settings.workflow).blueprint)
    calibration = calibration_id_of(settings.procedure)
    before = recorder.read_back(blueprint)
    initial = recorder.previous(before, workflow.initial)
    start = await recorder.started(msgspec.to_builtins(settings), calibration)
    if migration is not None:
        await recorder.record_migration(migration)
    if approval is not None:
        await recorder.record_approval(approval)
    await recorder.close_unfinished(before.begun)
    kept = recorder.kept
    for outcome in kept.unknown:
        log.warning("unknown_outcome", command=outcome.command, operation=f"{outcome.branch}.{outcome.operation}")
    note = log.info if kept.latched or kept.taken_back else log.debug
    note("recovered", latched=kept.latched, can_be_taken_back=sorted(kept.taken_back))
    return Recovered(replace(workflow, initial=initial), kept.latched, kept.unknown, start, kept.initial_joints)


async def conclude(recorder: JournalRecorder) -> None:
    """Journal the end of the daemon. A failure is only logged, since nothing more is decided."""
    try:
        await recorder.conclude()
    except JournalError as error:
        log.warning("no_last_snapshot", reason=error.text)


class _FailureSignal(DispatcherListener):
    """Listener that sets an event when the dispatcher fails."""

    def __init__(self, failed: asyncio.Event) -> None:
        self._failed = failed

    def on_failure(self) -> None:
        self._failed.set()


async def keep_journal(
    journal: Journal, recorder: JournalRecorder, dispatcher: Dispatcher[Any, Any], machine: Clock
) -> None:
    """Wait for the journal to fail, and reopen it as soon as the disk allows it; until cancelled.

    Meanwhile nothing is accepted but Stop. Afterwards the robot is held and latched until an operator acknowledges it.

    Args:
        journal: The journal.
        recorder: Recorder on the journal.
        dispatcher: The dispatcher.
        machine: The machine's clock.
    """
    failed = asyncio.Event()
    dispatcher.add_listener(_FailureSignal(failed))
    if dispatcher.broken is not None:
        failed.set()
    while True:
        await failed.wait()
        failed.clear()
        while dispatcher.broken is not None and dispatcher.broken.code == JournalError.code:
            try:
                await _reopen(journal, recorder, dispatcher)
            except PcmrsError as error:
                log.warning("journal_still_failing", reason=error.text)
                await machine.sleep(RETRY_AFTER)


async def _reopen(journal: Journal, recorder: JournalRecorder, dispatcher: Dispatcher[Any, Any]) -> None:
    """Reopen the journal, read it again, and resume the dispatcher.

    Raises:
        JournalError: The journal cannot be written yet, or acknowledged rows are lost.
        PcmrsError: The dispatcher cannot resume yet.
    """
    await journal.reopen()
    kept = recorder.read_back(dispatcher.procedure.blueprint)
    await dispatcher.resume({(each.source, each.command) for each in kept.begun})
