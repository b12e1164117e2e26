"""Failure and recovery: fail-stop, unknown outcomes, and resuming when the journal can be written again."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncIterator, Container, Iterable
from typing import Generic

import msgspec
import structlog

from pcmrs.dispatcher._activities import Activities
from pcmrs.dispatcher._admission import CommandAdmission
from pcmrs.dispatcher._timers import Timers
from pcmrs.dispatcher.decisions import JOURNAL, Decisions
from pcmrs.dispatcher.events import REOPENED, CompletedCommand, Recorder, failed
from pcmrs.dispatcher.execution import ExecutionContext
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.stops import StopControl
from pcmrs.dispatcher.verdict_cache import VerdictCache, wait_for_verdicts
from pcmrs.dispatcher.workflow import C, D
from pcmrs.errors import JournalError, PcmrsError
from pcmrs.fsm import Blueprint, Closure
from pcmrs.fsm.blueprint import OperationSpec
from pcmrs.messages import Command, Reason, UnknownOutcome, Verdict

log = structlog.get_logger(__name__)

ENDING_TIME = 10.0
"""Limit for commands that were stopped when the journal failed to end before the procedure is resumed, s."""


class PendingOutcomes:
    """Outcomes that are `unknown` and have not been settled since.

    A motion is settled by an accepted operation of its branch that has steps, such as `placement.locate`. Everything
    else is settled by an operation that acknowledges a Stop; if it does not act on the patient, also by an operation of
    its branch: an unfinished connection is settled by reconnecting.

    Of several unknown outcomes of one operation the newest is kept: the operator has to look once.

    Args:
        blueprint: The workflow.
        earlier: Outcomes that are unsettled already.
    """

    def __init__(self, blueprint: Blueprint, earlier: Iterable[UnknownOutcome] = ()) -> None:
        self._blueprint = blueprint
        self._outcomes = {(each.branch, each.operation): each for each in earlier}

    def shown(self) -> list[UnknownOutcome]:
        """Return all of them, in order of arrival."""
        return list(self._outcomes.values())

    def add(self, outcome: UnknownOutcome) -> None:
        """Add an outcome, in place of an earlier one of the same operation."""
        self._outcomes.pop((outcome.branch, outcome.operation), None)
        self._outcomes[outcome.branch, outcome.operation] = outcome

    def follow(self, command: Command, verdict: Verdict, now: float) -> None:
        """Add an unknown outcome, or drop those that an accepted operation settles.

        Args:
            command: The command.
            verdict: The verdict on it.
            now: Time of the verdict, Unix s.
        """
        if verdict.decision == "accepted":
            self.settle_by(command.branch, command.operation)
        elif verdict.decision == "unknown":
            self.add(
                UnknownOutcome(
                    command=command.id,
                    source=command.source,
                    branch=command.branch,
                    operation=command.operation,
                    since=now,
                )
            )

    def withdraw(self, source: str, command: str) -> None:
        """Drop the outcome of a command, since it has become known.

        Args:
            source: Source of the command.
            command: Its id.
        """
        self._outcomes = {
            key: each for key, each in self._outcomes.items() if (each.source, each.command) != (source, command)
        }

    def settle_by(self, branch: str, operation: str) -> None:
        """Drop the outcomes that an accepted operation settles.

        Args:
            branch: Branch of the operation.
            operation: Its name.
        """
        by = self._blueprint.find(branch, operation)
        if by is not None:
            self._outcomes = {key: each for key, each in self._outcomes.items() if not self._settles(branch, by, each)}

    def _settles(self, branch: str, by: OperationSpec, outcome: UnknownOutcome) -> bool:
        looks = branch == outcome.branch and bool(by.steps)
        of = self._blueprint.find(outcome.branch, outcome.operation)
        if of is not None and of.moves:
            return looks
        return by.unlatches or (looks and not (of is not None and of.affects_patient))


LOST = Reason(code=JOURNAL, text="The journal failed while it ran; its outcome is unknown.")


class Reconciliation(Generic[C, D]):
    """Make memory agree with the disk, while nothing runs and nothing is accepted.

    Args:
        procedure: The procedure.
        verdict_cache: Gets the verdicts that count.
        decisions: Has the unconfirmed commands.
        outcomes: Unknown outcomes.
        activities: Follow the commits.
        timers: Follow the commits.
    """

    def __init__(
        self,
        procedure: Procedure[C, D],
        verdict_cache: VerdictCache,
        decisions: Decisions[C, D],
        outcomes: PendingOutcomes,
        activities: Activities[C, D],
        timers: Timers[C, D],
    ) -> None:
        self._procedure = procedure
        self._verdict_cache = verdict_cache
        self._decisions = decisions
        self._outcomes = outcomes
        self._activities = activities
        self._timers = timers

    async def of_all(self, in_flight: Container[tuple[str, str]]) -> AsyncIterator[Verdict]:
        """Settle the unconfirmed commands one after the other, and yield the verdicts that count instead.

        Args:
            in_flight: Source and id of the commands of which the journal has the intent and no outcome.

        Raises:
            JournalError: The journal cannot be read or written; the remaining commands stay unconfirmed.
        """
        self._procedure.forget_promises()
        waiting, self._decisions.unconfirmed = self._decisions.unconfirmed, []
        try:
            while waiting:
                verdict = await self._of(waiting[0], in_flight)
                waiting.pop(0)
                if verdict is not None:
                    yield verdict
        finally:
            self._decisions.unconfirmed[:0] = waiting

    async def _of(self, completed: CompletedCommand[C, D], in_flight: Container[tuple[str, str]]) -> Verdict | None:
        command = completed.command
        self._verdict_cache.forget(command)
        verdict, is_new = self._verdict_cache.verdict_of(command)
        if not is_new:
            return self._take_recorded(completed, verdict.result())
        if (command.source, command.id) not in in_flight:  # then no step was taken, or they touched nothing outside
            self._verdict_cache.forget(command)
            self._outcomes.withdraw(command.source, command.id)
            return None
        self._decisions.conclude(self._unknown(command, verdict))
        return await asyncio.shield(verdict)  # others may wait for it when the resume is cancelled

    def _take_recorded(self, completed: CompletedCommand[C, D], recorded: Verdict) -> Verdict:
        command = completed.command
        self._decisions.commit_recorded(completed, recorded)
        self._activities.follow(command)
        self._timers.follow(command, recorded)
        if recorded.decision != "unknown":
            self._outcomes.withdraw(command.source, command.id)
        if recorded.decision == "accepted":
            self._outcomes.settle_by(command.branch, command.operation)
        return recorded

    def _unknown(self, command: Command, verdict: asyncio.Future[Verdict]) -> CompletedCommand[C, D]:
        """Completed as unknown, with the state that its operation declares for that."""
        closure = self._procedure.ask(command.branch, command.operation)
        change = closure.unknown if isinstance(closure, Closure) else None
        return CompletedCommand(command, verdict, "unknown", LOST, change=change)


class FailureRecovery(Generic[C, D]):
    """Fail safely, and resume after a failure of the journal.

    Args:
        context: Shared parts of the dispatcher.
        recorder: The journal.
        admission: Accepts nothing while the dispatcher has failed.
        stop_control: Latches Stop and follows the hold.
        activities: End with a failure.
        timers: Know which of their events still count.
        reconciliation: Settles the unconfirmed commands.
    """

    def __init__(
        self,
        context: ExecutionContext[C, D],
        recorder: Recorder,
        admission: CommandAdmission[C, D],
        stop_control: StopControl[C, D],
        activities: Activities[C, D],
        timers: Timers[C, D],
        reconciliation: Reconciliation[C, D],
    ) -> None:
        self._context = context
        self._coordinator = context.coordinator
        self._recorder = recorder
        self._locks = context.locks
        self._admission = admission
        self._stop_control = stop_control
        self._activities = activities
        self._timers = timers
        self._reconciliation = reconciliation
        self._listeners = context.listeners
        self._missed: dict[tuple[str, str, str], Command] = {}

    def fail(self, reason: Reason) -> Reason:
        """Fail-stop; see `Dispatcher.fail`."""
        before = self._admission.broken
        # A journal that can be written again does not repair the program, so that any other failure counts for more.
        if before is not None and not before.code == JournalError.code != reason.code:
            return before
        self._admission.broken = reason
        log.critical("fail_stop", reason=reason.text)
        number = self._stop_control.latch()
        self._context.tasks.spawn(self._stop_control.hold_after_failure(number))
        if before is None:
            self._activities.close()
            for pending in self._locks.running:
                pending.stop(reason)
            self._listeners.notify_failure()
        event = failed(reason)
        self._listeners.publish(event)
        self._coordinator.publish_snapshot()
        if reason.code != JournalError.code:
            self._context.tasks.spawn(self._coordinator.record(event).durable())
        return reason

    async def resume(self, in_flight: Container[tuple[str, str]]) -> None:
        """Resume after a failure of the journal; see `Dispatcher.resume`."""
        broken = self._admission.broken
        if broken is None:
            return
        if broken.code != JournalError.code:
            raise PcmrsError(f"Only a restart of the daemon helps: {broken.text}", reason=broken.code)
        await self._until_nothing_runs()
        number = self._stop_control.latch()
        stands = await self._context.hold.stop()
        self._activities.open()
        try:
            await self._reconcile(in_flight)
            await self._recorder.event(REOPENED, self._context.procedure.promised())
        except BaseException:
            self._activities.close()
            raise
        if self._admission.broken is not broken:  # the daemon is ending, or memory is not to be trusted
            self._activities.close()
            return
        self._admission.broken = None
        missed = self._stop_control.follow_danger(self._submit_missed)
        self._listeners.publish(REOPENED)
        self._coordinator.publish_snapshot()
        log.warning("resumed", after=broken.text)
        await self._activities.leave_ended()
        await wait_for_verdicts(missed)
        await self._stop_control.take_standstill(number, REOPENED.device, stands=stands)

    def remember_missed(self, command: Command, verdict: Verdict) -> None:
        """Remember the event of a device or timer that could not be decided: it is still true after the failure.

        That of a timer is not if the timer has ended or was restarted; so each source has its own.

        Args:
            command: The command of the device or timer.
            verdict: The verdict on it.
        """
        broken = self._admission.broken is not None
        if broken and verdict.decision != "accepted" and command.source.startswith(("device:", "timer:")):
            self._missed[command.source, command.branch, command.operation] = command

    async def _reconcile(self, in_flight: Container[tuple[str, str]]) -> None:
        async for verdict in self._reconciliation.of_all(in_flight):
            if verdict.decision == "accepted":
                self._missed = {key: each for key, each in self._missed.items() if each.id != verdict.id}
            self._coordinator.publish_verdict(verdict)

    async def _until_nothing_runs(self) -> None:
        try:
            async with self._context.clock.timeout(ENDING_TIME):
                while self._locks.running:
                    await asyncio.wait([pending.verdict for pending in self._locks.running])
        except TimeoutError:
            names = [pending.name for pending in self._locks.running]
            text = f"{' and '.join(names)} has not ended within {ENDING_TIME:g} s after it was stopped."
            raise PcmrsError(text, running=names) from None

    def _submit_missed(self) -> list[asyncio.Future[Verdict]]:
        missed, self._missed = self._missed, {}
        return [self._submit_again(command) for command in missed.values() if self._timers.counts(command)]

    def _submit_again(self, command: Command) -> asyncio.Future[Verdict]:
        again = msgspec.structs.replace(command, id=f"{command.operation}-{uuid.uuid4().hex}")
        verdict = self._admission.admit(again)
        self._timers.follow_again(again, verdict)
        return verdict
