"""From command to pending command: it starts, waits or is rejected; waiting commands are admitted again."""

from __future__ import annotations

import asyncio
import uuid
from typing import Generic

import msgspec

from pcmrs.dispatcher._activities import Activities
from pcmrs.dispatcher._performer import Performer
from pcmrs.dispatcher.command_checks import (
    CHECKS_BEGIN_WITHIN,
    EVENT_SOURCES,
    check_fresh,
    check_role,
    find_operation,
    read_payload,
)
from pcmrs.dispatcher.decisions import Decisions
from pcmrs.dispatcher.events import DAEMON, CompletedCommand
from pcmrs.dispatcher.execution import ExecutionContext, reason_of
from pcmrs.dispatcher.lease import LEASE, RENEW, TAKEN, Lease
from pcmrs.dispatcher.locks import PendingCommand, locks_for
from pcmrs.dispatcher.stops import Stops
from pcmrs.dispatcher.verdict_cache import VerdictCache
from pcmrs.dispatcher.workflow import C, D
from pcmrs.errors import JournalError, PcmrsError, RefusalError
from pcmrs.fsm import Closure, Denial
from pcmrs.messages import Command, DeviceEvent, DryRunResult, Reason, Verdict


class CommandAdmission(Generic[C, D]):
    """Admit commands: each starts, waits or is rejected.

    Args:
        context: Shared parts of the dispatcher.
        lease: Lease of the cell.
        stops: Says whether a Stop may be acknowledged.
        verdict_cache: Verdicts by source and id.
        decisions: Concludes rejected commands.
        performer: Performs admitted commands.
        activities: Activities that may move the robot.

    Attributes:
        lease: Lease of the cell.
        broken: Why nothing is accepted any more; None in operation.
        suspended: Why commands are rejected for now; None in operation.
        motion_barred: Why commands that move towards the patient or act on it are rejected for now; None in operation.
    """

    def __init__(
        self,
        context: ExecutionContext[C, D],
        lease: Lease,
        stops: Stops,
        verdict_cache: VerdictCache,
        decisions: Decisions[C, D],
        performer: Performer[C, D],
        activities: Activities[C, D],
    ) -> None:
        self.lease = lease
        self.broken: Reason | None = None
        self.suspended: Reason | None = None
        self.motion_barred: Reason | None = None
        self._coordinator = context.coordinator
        self._workflow = context.workflow
        self._procedure = context.procedure
        self._clock = context.clock
        self._tasks = context.tasks
        self._stops = stops
        self._locks = context.locks
        self._verdict_cache = verdict_cache
        self._decisions = decisions
        self._performer = performer
        self._activities = activities
        self._dry_running = asyncio.Lock()

    @property
    def moving(self) -> bool:
        """True while something moves the robot, or a motion waits."""
        return self._activities.moving or self._locks.moving

    @property
    def only_retreats(self) -> bool:
        """True if everything that moves the robot is a retreat; also if nothing does."""
        pending = (*self._locks.running, *self._locks.waiting)
        return not self._activities.moving and not any(each.spec.motion == "approach" for each in pending)

    def admit(self, command: Command, arrived: float | None = None) -> asyncio.Future[Verdict]:
        """Admit a command at once, unless it repeats an earlier one.

        Args:
            command: The command.
            arrived: Time of its arrival at the edge of the daemon, s of the event loop's clock; by default now.

        Returns:
            Its verdict, done or to come.
        """
        try:
            verdict, is_new = self._verdict_cache.verdict_of(command)
        except RefusalError as error:  # no row: the one of this id is about something else
            verdict, is_new = asyncio.get_running_loop().create_future(), False
            self._decisions.reject_unrecorded(command, verdict, reason_of(error))
        except JournalError as error:
            verdict, is_new = asyncio.get_running_loop().create_future(), False
            self._decisions.fail_with(CompletedCommand(command, verdict, "rejected"), error)
        if is_new:
            try:
                self._admit(command, verdict, arrived)
            except Exception as error:
                self._decisions.fail_with(CompletedCommand(command, verdict, "rejected"), error)
        return verdict

    def admit_event(self, event: DeviceEvent) -> list[asyncio.Future[Verdict]]:
        """Admit the event operations that a device's event calls; return the verdicts to come."""
        return [
            self.admit(
                Command(
                    id=f"{event.code}-{uuid.uuid4().hex}",
                    branch=name,
                    operation=event.code,
                    source=f"device:{event.device}",
                    user=DAEMON,
                    role="daemon",
                )
            )
            for name, branch in self._workflow.blueprint.branches.items()
            if event.code in branch.operations and branch.operations[event.code].event
        ]

    def admit_waiting(self) -> None:
        """Admit all waiting commands again: each starts, waits on, or is rejected."""
        for pending in self._locks.take_waiting():
            try:
                self._admit_again(pending)
            except Exception as error:  # the others have been taken out of the queue, too
                pending.end_wait()
                self._decisions.fail_with(CompletedCommand(pending.command, pending.verdict, "rejected"), error)

    async def dry_run(self, command: Command) -> DryRunResult:
        """Return what the verdict on a command would rest on now; see `Dispatcher.dry_run`."""
        async with self._dry_running:
            return await self._dry_run(command)

    def objection(self, pending: PendingCommand) -> Reason | None:
        """Return why a pending command is not allowed now: failure, latch, lease or states; None if it is."""
        answer = self._procedure.ask(pending.command.branch, pending.command.operation)
        return self._barred(pending) or self._refused(pending, answer)

    async def _dry_run(self, command: Command) -> DryRunResult:
        try:
            pending, answer = self._pending_command(command, asyncio.get_running_loop().create_future())
        except PcmrsError as error:
            return DryRunResult(reason=reason_of(error))
        reason = self._suspended_for(command) or self._barred(pending) or self._scene_objection(pending)
        reason = reason or self._refused(pending, answer)
        if reason is None and (self.moving or self._locks.blocked(pending)):
            text = f"Something runs, so that {pending.name} is not looked at: ask again when it has ended."
            reason = Reason(code="busy", text=text)
        return await self._performer.dry_run(pending) if reason is None else DryRunResult(reason=reason)

    def _admit(self, command: Command, verdict: asyncio.Future[Verdict], arrived: float | None) -> None:
        suspended = self._suspended_for(command)
        if suspended is not None:
            self._decisions.reject_unrecorded(command, verdict, suspended)
            self._verdict_cache.forget(command)
            return
        if command.branch == LEASE:
            self._admit_lease(command, verdict)
            return
        try:
            pending, answer = self._pending_command(command, verdict, arrived)
        except PcmrsError as error:
            self._decisions.reject(command, verdict, reason_of(error))
            return
        blocked = self._locks.blocked(pending)
        reason = self._barred(pending) or self._scene_objection(pending)
        reason = reason or (self._locks.why_not_wait(pending) if blocked else self._refused(pending, answer))
        if reason is not None:
            self._decisions.reject(command, verdict, reason)
        elif blocked:
            self._wait(pending)
        else:
            self._performer.start(pending)

    def _admit_lease(self, command: Command, verdict: asyncio.Future[Verdict]) -> None:
        """Decide at once; a renewal changes nothing, and leaves no row."""
        before = self.lease.holder
        reason = self.broken or self._too_old(command) or self.lease.decide(command)
        if reason is not None:
            self._decisions.reject(command, verdict, reason)
        elif command.operation == RENEW:
            self._decisions.answer_unrecorded(CompletedCommand(command, verdict, "accepted"))
        else:
            self._decisions.conclude(CompletedCommand(command, verdict, "accepted"))
        if before not in (None, self.lease.holder) and self.moving:
            text = f"{before} does not hold this cell any more, and the robot moves."
            self._tasks.spawn(self._coordinator.stop(command.source, Reason(code=TAKEN, text=text)))

    def _admit_again(self, pending: PendingCommand) -> None:
        answer = self._procedure.ask(pending.command.branch, pending.command.operation)
        pending.locks = locks_for(self._workflow.blueprint, pending.command, answer)
        blocked = self._locks.blocked(pending)
        if blocked:
            reason = self._locks.why_not_wait(pending) if pending.moves else None
        else:
            reason = self._barred(pending) or self._too_old(pending.command) or self._refused(pending, answer)
        if reason is not None:
            pending.end_wait()
            self._decisions.reject(pending.command, pending.verdict, reason)
        elif blocked:
            self._locks.waiting.append(pending)
        else:
            self._performer.start(pending)

    def _wait(self, pending: PendingCommand) -> None:
        replaced = self._locks.wait(pending)
        if replaced is not None:
            text = f"{pending.command.source} has reported {pending.name} again: the newer report counts."
            reason = Reason(code="replaced", text=text)
            self._decisions.answer_unrecorded(CompletedCommand(replaced.command, replaced.verdict, "rejected", reason))
        if pending.moves:
            latest = pending.arrived + CHECKS_BEGIN_WITHIN
            pending.wait_timer = asyncio.get_running_loop().call_at(latest, self._reject_busy, pending)

    def _reject_busy(self, motion: PendingCommand) -> None:
        """Reject a motion that has waited as long as a motion may."""
        self._locks.waiting.remove(motion)
        self._decisions.reject(motion.command, motion.verdict, self._locks.busy(motion))

    def _pending_command(
        self, command: Command, verdict: asyncio.Future[Verdict], arrived: float | None = None
    ) -> tuple[PendingCommand, Closure | Denial]:
        """Return the command as a pending one, and the answer of the states to it.

        Raises:
            PcmrsError: The command is refused whatever the states are.
        """
        spec = find_operation(self._workflow, command)
        check_role(command, spec)
        check_fresh(self._clock, command)
        payload = read_payload(self._workflow, command, spec)
        answer = self._procedure.ask(command.branch, command.operation)
        locks = locks_for(self._workflow.blueprint, command, answer)
        arrived = asyncio.get_running_loop().time() if arrived is None else arrived
        side_effecting = self._performer.has_side_effects(spec)
        return PendingCommand(command, spec, payload, verdict, locks, arrived, side_effecting), answer

    def _suspended_for(self, command: Command) -> Reason | None:
        """Why a command is not taken for now; events, retreats and the release of Stop for them always are."""
        spec = self._workflow.blueprint.find(command.branch, command.operation)
        leaves = spec is not None and (spec.motion == "retreat" or spec.unlatches)
        return None if leaves or command.source.startswith(EVENT_SOURCES) else self.suspended

    def _scene_objection(self, pending: PendingCommand) -> Reason | None:
        """Why the scene does not allow a command that moves towards the patient or acts on it; None if it does."""
        return self.motion_barred if pending.acts and pending.spec.motion != "retreat" else None

    def _barred(self, pending: PendingCommand) -> Reason | None:
        """Why a command is not allowed in any state: latch, failure or lease."""
        if self.broken is None and pending.spec.blocked_when_latched and self._procedure.latched:
            release = " or ".join(self._workflow.blueprint.unlatching)
            text = f"{pending.name} is not allowed while Stop is latched: acknowledge with {release} first."
            return self._led_on(pending, Reason(code="latched", text=text))
        return self.broken or self.lease.objection(pending.command)

    def _refused(self, pending: PendingCommand, answer: Closure | Denial) -> Reason | None:
        """Why the states do not allow it, or why an acknowledgement does not answer the newest Stop."""
        if isinstance(answer, Denial):
            return self._led_on(pending, Reason(code=answer.code, text=answer.text, fields=answer.fields))
        if not pending.spec.unlatches:
            return None
        return self._stops.objection(pending.command, latched=self._procedure.latched)

    def _led_on(self, pending: PendingCommand, reason: Reason) -> Reason:
        """Return the reason with the operation that leads on to the refused one, if any does."""
        following = self._procedure.way_to(pending.command.branch, pending.command.operation).next
        if not following:
            return reason
        text = reason.text if following in reason.text else f"{reason.text} Next: {following}."
        return msgspec.structs.replace(reason, text=text, fields=reason.fields | {"next": following})

    def _too_old(self, command: Command) -> Reason | None:
        try:
            check_fresh(self._clock, command)
        except PcmrsError as error:
            return reason_of(error)
        return None
