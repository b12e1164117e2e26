"""The dispatcher (D-SFO): takes commands, asks the active states, performs operations, transitions."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Awaitable, Callable, Container, Iterable, Sequence
from functools import partial
from typing import Any, Generic

import msgspec
import structlog

from pcmrs.clock import Clock
from pcmrs.dispatcher.activities import Activities
from pcmrs.dispatcher.admission import (
    CHECKS_BEGIN_WITHIN,
    EVENT_SOURCES,
    check_fresh,
    check_role,
    find_operation,
    read_payload,
)
from pcmrs.dispatcher.decisions import TOO_MANY, CompletedCommand, Decisions, Rejections, reason_for
from pcmrs.dispatcher.events import DAEMON, REOPENED, SHUTDOWN, failed, not_confirmed, pressed_again, stopped
from pcmrs.dispatcher.execution import Checks, ExecutionContext, Planner, performing, reason_of
from pcmrs.dispatcher.lease import LEASE, RENEW, TAKEN, Lease
from pcmrs.dispatcher.locks import LockManager, PendingCommand, locks_for
from pcmrs.dispatcher.performer import Performer
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.recorder import QueuedRow, Recorder
from pcmrs.dispatcher.recovery import PendingOutcomes, Reconciliation
from pcmrs.dispatcher.run import C, D, Run
from pcmrs.dispatcher.stops import STANDSTILL, Hold, Presses, Stops, StopUnderWay
from pcmrs.dispatcher.tasks import Tasks
from pcmrs.dispatcher.verdict_cache import VerdictCache
from pcmrs.dispatcher.workflow import Workflow
from pcmrs.errors import JournalError, PcmrsError, ReentrancyError, RefusalError
from pcmrs.fsm import Closure, Denial
from pcmrs.messages import Command, DeviceEvent, DryRunResult, Reason, Snapshot, UnknownOutcome, Verdict

log = structlog.get_logger(__name__)

ENDING = "ending"
"""Code of the reason why a dispatcher that is being closed accepts nothing more: no failure."""
ENDING_TIME = 10.0
"""What was stopped when the journal failed has so long to end before the procedure goes on, s."""


class Dispatcher(Generic[C, D]):
    """Runs one procedure of one cell; every edge of the system ends in `submit` or `stop`.

    Args:
        workflow: The procedure.
        cell: The devices and frames that its operations use.
        clock: The cell's clock.
        recorder: The journal.
        hold: Holds the robot, latches it if told to, and returns when it stands still; raises when that is not
            confirmed.
        publish: Called in the event loop with every new snapshot, verdict and device event.
        release: Ends the latch of the devices for an operation that acknowledges a Stop, and returns the names of those
            that stay latched; told whether Stop is latched now; raises where the robot does not stand. None for devices
            that Stop does not latch.
        lease_required: Somebody has to hold the cell before commands are taken.
        planner: Asks the checks that plan motions; without one they are asked in the loop.
        rejections: Says which rejections get no row; without it all get one.

    Attributes:
        lease: Who holds the cell.
        in_doubt: The hold of a stop or a failure has not been confirmed, and nobody has acknowledged that since.
    """

    def __init__(
        self,
        workflow: Workflow[C, D],
        cell: C,
        clock: Clock,
        recorder: Recorder,
        hold: Callable[[bool], Awaitable[object]],
        publish: Callable[[Snapshot | Verdict | DeviceEvent], None],
        *,
        release: Callable[[bool], Awaitable[Sequence[str]]] | None = None,
        lease_required: bool = False,
        planner: Planner[C, D] | None = None,
        rejections: Rejections | None = None,
    ) -> None:
        self.lease = Lease(clock, required=lease_required)
        self.procedure = Procedure(workflow)
        self._workflow = workflow
        self._clock = clock
        self._recorder = recorder
        self._publishers = [publish]
        self._tasks = Tasks(self._break)
        self._hold = Hold(hold, self._tasks)
        self._stops = Stops(clock)
        self._presses = Presses(self._tell_presses)
        context = ExecutionContext(
            workflow, self.procedure, cell, clock, self._hold, self._tasks, self._show_snapshot, release
        )
        self._locks = LockManager(workflow.blueprint.revokers)
        self._verdict_cache = VerdictCache(recorder)
        self._decisions = Decisions(
            self.procedure, recorder, self._verdict_cache, self._settle, self._break, rejections
        )
        self._rejections = rejections
        if rejections is not None:
            rejections.on_dropped(lambda event: self._tasks.spawn(self._tell(event).durable()))
        self._activities = Activities(context, self._verdict_of, self.stop, self._tell, self._break)
        checks = Checks(context, planner, self._objection)
        self._performer = Performer(context, self._locks, self._decisions, recorder, self._activities, checks)
        self._dry_running = asyncio.Lock()
        self._outcomes = PendingOutcomes(workflow.blueprint)
        self._reconciliation = Reconciliation(
            self.procedure, self._verdict_cache, self._decisions, self._outcomes, self._activities
        )
        self._missed: dict[tuple[str, str], Command] = {}
        self._broken: Reason | None = None
        self._suspended: Reason | None = None
        self._break_listeners: list[Callable[[], None]] = []
        self._stop_listeners: list[Callable[[], None]] = []
        self._accept_listeners: list[Callable[[Command], None]] = []
        self.in_doubt = False

    # -- what the edges of the system call -----------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """The joint state of all branches, and what is running and going on."""
        running = [pending.shown for pending in self._locks.running if pending.begun and not pending.verdict.done()]
        activities, unknown = self._activities.shown(), self._outcomes.shown()
        return self.procedure.snapshot(running, activities, unknown, self.lease.state, self._stops.state)

    @property
    def broken(self) -> Reason | None:
        """Why nothing is accepted any more; None in operation."""
        return self._broken

    @property
    def waiting(self) -> int:
        """Commands that wait for others to end."""
        return len(self._locks.waiting)

    @property
    def stop_number(self) -> int:
        """Number of the newest Stop; 0 before the first one."""
        return self._stops.state.number

    @property
    def idle(self) -> bool:
        """Whether nothing moves the robot, nor brakes it after a Stop: then its joints must not move."""
        return self._stops.standing and not self._moves()

    def take_up(self, *, latched: bool, unknown: Iterable[UnknownOutcome], start: int = 0) -> None:
        """Takes over what an earlier run has left for an operator to settle; before anything is submitted.

        Args:
            latched: A Stop of the earlier run has not been acknowledged.
            unknown: Outcomes that nobody knows.
            start: Grows with each run of the daemon: Stops are numbered from it.
        """
        self._stops.number_from(start)
        for outcome in unknown:
            self._outcomes.add(outcome)
        if latched:
            self._latch()

    async def submit(self, command: Command, *, arrived: float | None = None) -> Verdict:
        """Decides on a command, performs it when it is allowed, and returns the verdict.

        Cancelling the caller does not cancel the operation. A repeat of (source, id) gets the recorded
        verdict, or waits for the one under way, and runs nothing.

        Args:
            command: What is asked.
            arrived: When it arrived at the edge of the daemon, s of the event loop's clock; by default now.

        Raises:
            ReentrancyError: An operation awaits its own dispatcher; it may `Run.post` instead.
        """
        if performing.get() == id(self.procedure):
            raise ReentrancyError(f"{command.branch}.{command.operation} was awaited by a running operation: post it.")
        verdict = self._verdict_of(command, arrived)
        return verdict.result() if verdict.done() else await asyncio.shield(verdict)

    async def dry_run(self, command: Command) -> DryRunResult:
        """What would be said to a command now: nothing is performed, changed or journalled.

        While the arm moves no check is asked, since each takes time from what holds it to its way. One command is
        looked at at a time, so that a motion never waits for more than one of them.
        """
        async with self._dry_running:
            return await self._dry_run(command)

    async def _dry_run(self, command: Command) -> DryRunResult:
        try:
            pending, answer = self._pending_command(command, asyncio.get_running_loop().create_future())
        except PcmrsError as error:
            return DryRunResult(reason=reason_of(error))
        reason = self._suspended_for(command) or self._barred(pending) or self._refused(pending, answer)
        if reason is None and (self._moves() or self._locks.blocked(pending)):
            text = f"Something runs, so that {pending.name} is not looked at: ask again when it has ended."
            reason = Reason(code="busy", text=text)
        return await self._performer.dry_run(pending) if reason is None else DryRunResult(reason=reason)

    def on_stop(self, callback: Callable[[], None]) -> None:
        """Has `callback` called synchronously at every stop, whatever way it came."""
        self._stop_listeners.append(callback)

    def on_break(self, callback: Callable[[], None]) -> None:
        """Has `callback` called when the dispatcher accepts nothing any more; see `broken`."""
        self._break_listeners.append(callback)

    def on_accepted(self, callback: Callable[[Command], None]) -> None:
        """Has `callback` called with every command that was accepted, as soon as it is committed."""
        self._accept_listeners.append(callback)

    def on_publish(self, callback: Callable[[Snapshot | Verdict | DeviceEvent], None]) -> None:
        """Has `callback` called, too, with every new snapshot, verdict and device event."""
        self._publishers.append(callback)

    async def stop(
        self,
        source: str,
        reason: Reason | None = None,
        then: Callable[[], list[asyncio.Future[Verdict]]] = list,
    ) -> bool:
        """Stops everything: never queues, wins in every state, latches until acknowledged.

        Returns when every running operation, and every activity that moves, has ended: whether the robot has confirmed
        that it stands.

        Args:
            source: Who stops.
            reason: Why; by default that `source` has asked for it.
            then: Submits what follows from a danger event, before anything is awaited, and returns the verdicts to
                come: nobody can acknowledge or move before what has happened is taken into account.
        """
        return await asyncio.shield(self.begin_stop(source, reason, then))

    def begin_stop(
        self,
        source: str,
        reason: Reason | None = None,
        then: Callable[[], list[asyncio.Future[Verdict]]] = list,
    ) -> asyncio.Task[bool]:
        """Begins to stop everything; see `stop`.

        When this returns, the Stop has its number, the latch is set and the holds are on their way. The result of the
        task is whether the robot has confirmed that it stands.
        """
        reason = reason or Reason(code="stopped", text=f"Stopped by {source}.", fields={"source": source})
        number, holding = self._latch(), self._hold.stop()
        self._stops.wait_for(STANDSTILL, holding)
        moving = self._activities.end_moving()
        ending = [pending.verdict for pending in self._locks.running]
        for pending in self._locks.running:
            pending.stop(reason)
        for callback in self._stop_listeners:
            _guarded(callback)
        for pending in self._locks.turn_away():
            pending.end_wait()
            self._reject(pending.command, pending.verdict, reason)
        event = stopped(source, reason, number)
        self._publish(event)
        recorded = self._record_event(event)
        following = self._follow_danger(then)
        self._show_snapshot()
        return self._tasks.spawn(self._end_stop(number, source, recorded, [holding, *ending, *moving, *following]))

    def press_stop(self, source: str, presses: int = 1) -> StopUnderWay:
        """Stops for somebody who asks for it; see `begin_stop`.

        A press that meets a Stop of the same source under way is that Stop, unless something has begun since: it is
        counted, and its answer is that Stop's.

        Args:
            source: Who stops.
            presses: How often this source has pressed since the last call.
        """
        stop = self._presses.find(source)
        if stop is None or self._begun_since_stop():
            standing = self.begin_stop(source)
            stop, presses = StopUnderWay(source, self.stop_number, standing), presses - 1
            self._presses.add(stop, self._hold.stop())
        else:
            for callback in self._stop_listeners:
                _guarded(callback)  # what has come to the edges since ends, too
        if presses:
            stop.join(source, presses)
        return stop

    def _begun_since_stop(self) -> bool:
        """Whether anything runs or waits that the last Stop has not ended."""
        running = any(pending.stopped is None for pending in self._locks.running)
        return running or any(not pending.spec.event for pending in self._locks.waiting)

    def _tell_presses(self, stop: StopUnderWay) -> None:
        self._tasks.spawn(self._tell(pressed_again(stop.source, stop.number, stop.joined)).durable())

    async def _end_stop(self, number: int, source: str, recorded: QueuedRow, ending: list[asyncio.Future[Any]]) -> bool:
        await recorded
        await asyncio.wait(ending)
        confirmed = all(each.result() is not False for each in ending)
        await self._take_standstill(number, source, stands=confirmed)
        return confirmed

    def _latch(self) -> int:
        """Sets the latch, which is a Stop of its own; returns its number."""
        self._stops.begin()
        self.procedure.latch()
        return self._stops.state.number

    async def report(self, event: DeviceEvent) -> None:
        """Takes a device's event: danger goes the way of Stop; its event operations are submitted at once."""
        self.lease.follow(event)
        if event.danger:
            reason = Reason(code=event.code, text=event.text, fields=event.fields)
            await self.stop(f"device:{event.device}", reason, partial(self._submit_operations_of, event))
            return
        told = self._tell(event)
        following = self._submit_operations_of(event)
        await told
        await _all_of(following)

    def report_later(self, event: DeviceEvent) -> None:
        """Reports an event without waiting until it is durable."""
        self._tasks.spawn(self.report(event))

    def fail(self, reason: Reason) -> Reason:
        """Fail-stop: the robot is held, Stop is latched, nothing is accepted any more; Stop and status still work.

        Returns:
            Why nothing is accepted: `reason`, unless something else has failed before that is not less.
        """
        before = self._broken
        # A journal that can be written again does not mend the program, so that any other failure counts for more.
        if before is not None and not before.code == JournalError.code != reason.code:
            return before
        self._broken = reason
        log.critical("fail_stop", reason=reason.text)
        number = self._latch()
        self._tasks.spawn(self._hold_or_doubt(number))
        if before is None:
            self._activities.close()
            for pending in self._locks.running:
                pending.stop(reason)
            for callback in self._break_listeners:
                _guarded(callback)
        event = failed(reason)
        self._publish(event)
        self._show_snapshot()
        if reason.code != JournalError.code:
            self._tasks.spawn(self._record_event(event).durable())
        return reason

    def suspend(self, reason: Reason | None) -> None:
        """Rejects commands for `reason` until called again with None; Stop, events and what runs go on.

        A retreat is allowed, and what releases Stop for it: nobody may be kept from leaving the patient.

        Such a rejection leaves no row: a repeat of the command is decided anew when commands are taken again.
        """
        self._suspended = reason

    async def close(self) -> None:
        """Ends the procedure: the robot is held, whatever runs is stopped, and nothing more is accepted."""
        self._broken = Reason(code=ENDING, text="The daemon is ending.")
        self._activities.close()
        if self._rejections is not None:
            self._rejections.tell()
        await self.stop(SHUTDOWN)
        await self._tasks.wait()

    async def resume(self, begun: Container[tuple[str, str]]) -> None:
        """Goes on after a failure of the journal: held, latched, and with what the disk says.

        What was being journalled when it failed is committed where the disk has it. What had begun is `unknown`, with
        the state that its operation declares for that. Anything else has never been.

        Args:
            begun: Source and id of the commands of which the journal has the intent and no outcome.

        Raises:
            PcmrsError: It was not the journal that failed: memory is not to be trusted. Or something still runs.
            JournalError: The journal has failed again.
        """
        broken = self._broken
        if broken is None:
            return
        if broken.code != JournalError.code:
            raise PcmrsError(f"Only a restart of the daemon helps: {broken.text}", reason=broken.code)
        await self._until_nothing_runs()
        number = self._latch()
        stands = await self._hold.stop()
        self._activities.open()
        try:
            await self._reconcile(begun)
            await self._recorder.event(REOPENED, self.procedure.promised())
        except BaseException:
            self._activities.close()
            raise
        if self._broken is not broken:  # the daemon is ending, or memory is not to be trusted
            self._activities.close()
            return
        self._broken = None
        missed = self._follow_danger(self._submit_missed)
        self._publish(REOPENED)
        self._show_snapshot()
        log.warning("resumed", after=broken.text)
        await self._activities.leave_ended()
        await _all_of(missed)
        await self._take_standstill(number, REOPENED.device, stands=stands)

    async def _reconcile(self, begun: Container[tuple[str, str]]) -> None:
        async for verdict in self._reconciliation.of_all(begun):
            if verdict.decision == "accepted":
                self._missed = {key: each for key, each in self._missed.items() if each.id != verdict.id}
            self._show(verdict)

    # -- from command to pending command -----------------------------------------------------------------------

    def _verdict_of(self, command: Command, arrived: float | None = None) -> asyncio.Future[Verdict]:
        try:
            verdict, is_new = self._verdict_cache.verdict_of(command)
        except RefusalError as error:  # no row: the one of this id is about something else
            verdict, is_new = asyncio.get_running_loop().create_future(), False
            self._decisions.answer_unrecorded(CompletedCommand(command, verdict, "rejected", reason_of(error)))
            self._publish(verdict.result())
        except JournalError as error:
            verdict, is_new = asyncio.get_running_loop().create_future(), False
            self._decisions.break_off(CompletedCommand(command, verdict, "rejected"), error)
        if is_new:
            try:
                self._admit(command, verdict, arrived)
            except Exception as error:
                self._decisions.break_off(CompletedCommand(command, verdict, "rejected"), error)
        return verdict

    def _admit(self, command: Command, verdict: asyncio.Future[Verdict], arrived: float | None) -> None:
        """Turns a command into a pending one that starts, waits or is rejected."""
        suspended = self._suspended_for(command)
        if suspended is not None:
            self._decisions.answer_unrecorded(CompletedCommand(command, verdict, "rejected", suspended))
            self._verdict_cache.forget(command)
            self._publish(verdict.result())
            return
        if command.branch == LEASE:
            self._admit_lease(command, verdict)
            return
        try:
            pending, answer = self._pending_command(command, verdict, arrived)
        except PcmrsError as error:
            self._reject(command, verdict, reason_of(error))
            return
        blocked = self._locks.blocked(pending)
        reason = self._barred(pending) or (
            self._locks.why_not_wait(pending) if blocked else self._refused(pending, answer)
        )
        if reason is not None:
            self._reject(command, verdict, reason)
        elif blocked:
            self._wait(pending)
        else:
            self._performer.start(pending)

    def _suspended_for(self, command: Command) -> Reason | None:
        """Why a command is not taken for now; nothing keeps events from being heard, nor anybody from retreating."""
        spec = self._workflow.blueprint.find(command.branch, command.operation)
        leaves = spec is not None and (spec.motion == "retreat" or spec.unlatches)
        return None if leaves or command.source.startswith(EVENT_SOURCES) else self._suspended

    def _wait(self, pending: PendingCommand) -> None:
        replaced = self._locks.wait(pending)
        if replaced is not None:
            text = f"{pending.command.source} has reported {pending.name} again: the newer report counts."
            reason = Reason(code="replaced", text=text)
            self._decisions.answer_unrecorded(CompletedCommand(replaced.command, replaced.verdict, "rejected", reason))
        if pending.moves:
            latest = pending.arrived + CHECKS_BEGIN_WITHIN
            pending.patience = asyncio.get_running_loop().call_at(latest, self._lose_patience, pending)

    def _lose_patience(self, motion: PendingCommand) -> None:
        """It has waited as long as a motion may."""
        self._locks.waiting.remove(motion)
        self._reject(motion.command, motion.verdict, self._locks.busy(motion))

    def _pending_command(
        self, command: Command, verdict: asyncio.Future[Verdict], arrived: float | None = None
    ) -> tuple[PendingCommand, Closure | Denial]:
        """The command as a pending one, and what the states say to it.

        Raises:
            PcmrsError: It is refused whatever the states are.
        """
        spec = find_operation(self._workflow, command)
        check_role(command, spec)
        check_fresh(self._clock, command)
        payload = read_payload(self._workflow, command, spec)
        answer = self.procedure.ask(command.branch, command.operation)
        locks = locks_for(self._workflow.blueprint, command, answer)
        arrived = asyncio.get_running_loop().time() if arrived is None else arrived
        side_effecting = self._performer.has_side_effects(spec)
        return PendingCommand(command, spec, payload, verdict, locks, arrived, side_effecting), answer

    def _admit_lease(self, command: Command, verdict: asyncio.Future[Verdict]) -> None:
        """Decides at once; what renews a lease changes nothing, and leaves no row."""
        before = self.lease.holder
        reason = self._broken or self._too_old(command) or self.lease.decide(command)
        if reason is not None:
            self._reject(command, verdict, reason)
        elif command.operation == RENEW:
            self._decisions.answer_unrecorded(CompletedCommand(command, verdict, "accepted"))
        else:
            self._decisions.conclude(CompletedCommand(command, verdict, "accepted"))
        if before not in (None, self.lease.holder) and self._moves():
            text = f"{before} does not hold this cell any more, and the robot moves."
            self._tasks.spawn(self.stop(command.source, Reason(code=TAKEN, text=text)))

    def _refused(self, pending: PendingCommand, answer: Closure | Denial) -> Reason | None:
        """Why the states do not allow it, or why an acknowledgement does not answer the newest Stop."""
        if isinstance(answer, Denial):
            return Reason(code=answer.code, text=answer.text, fields=answer.fields)
        if not pending.spec.unlatches:
            return None
        return self._stops.objection(pending.command, latched=self.procedure.latched)

    def _moves(self) -> bool:
        return self._activities.moving or self._locks.moving

    def _too_old(self, command: Command) -> Reason | None:
        try:
            check_fresh(self._clock, command)
        except PcmrsError as error:
            return reason_of(error)
        return None

    def _barred(self, pending: PendingCommand) -> Reason | None:
        if self._broken is None and pending.spec.blocked_when_latched and self.procedure.latched:
            release = " or ".join(self._workflow.blueprint.unlatching)
            text = f"{pending.name} is not allowed while Stop is latched: acknowledge with {release} first."
            return Reason(code="latched", text=text)
        return self._broken or self.lease.objection(pending.command)

    def _objection(self, pending: PendingCommand) -> Reason | None:
        """Why a command that was allowed to begin is not any more, if it is not."""
        answer = self.procedure.ask(pending.command.branch, pending.command.operation)
        return self._barred(pending) or self._refused(pending, answer)

    def _start_waiting(self) -> None:
        """Asks again for everything that waited: it starts, waits on, or is rejected."""
        for pending in self._locks.take_waiting():
            try:
                self._admit_again(pending)
            except Exception as error:  # the others have been taken out of the queue, too
                pending.end_wait()
                self._decisions.break_off(CompletedCommand(pending.command, pending.verdict, "rejected"), error)

    def _admit_again(self, pending: PendingCommand) -> None:
        answer = self.procedure.ask(pending.command.branch, pending.command.operation)
        pending.locks = locks_for(self._workflow.blueprint, pending.command, answer)
        blocked = self._locks.blocked(pending)
        if blocked:
            reason = self._locks.why_not_wait(pending) if pending.moves else None
        else:
            reason = self._barred(pending) or self._too_old(pending.command) or self._refused(pending, answer)
        if reason is not None:
            pending.end_wait()
            self._reject(pending.command, pending.verdict, reason)
        elif blocked:
            self._locks.waiting.append(pending)
        else:
            self._performer.start(pending)

    # -- from completed command to what follows ------------------------------------------------------------

    def _reject(self, command: Command, verdict: asyncio.Future[Verdict], reason: Reason) -> None:
        self._decisions.conclude(CompletedCommand(command, verdict, "rejected", reason))

    def _settle(self, completed: CompletedCommand[C, D], verdict: Verdict) -> None:
        """The verdict is given: shows it, and lets others have the locks, whatever fails of what follows from it."""
        if verdict.decision == "accepted":
            for callback in self._accept_listeners:
                _guarded(callback, completed.command)
        loop = asyncio.get_running_loop()
        loop.call_soon(self._show, verdict)  # those who asked hear of it before those who watch
        if completed.pending is not None:
            self._locks.running.remove(completed.pending)
            if self._locks.waiting:
                loop.call_soon(self._start_waiting)
        try:
            self._follow(completed, verdict)
        except Exception as error:
            log.exception("verdict_not_followed", command=verdict.id)
            self._break(error)

    def _follow(self, completed: CompletedCommand[C, D], verdict: Verdict) -> None:
        """Does what follows from a verdict."""
        self.in_doubt = self.in_doubt and not completed.unlatches
        self._outcomes.follow(completed.command, verdict, self._clock.wall())
        self._activities.follow(completed.command)
        self._remember_missed(completed.command, verdict)
        if completed.run is not None and verdict.decision == "accepted":
            self._submit_posts(completed.command, completed.run)

    async def _until_nothing_runs(self) -> None:
        try:
            async with self._clock.timeout(ENDING_TIME):
                while self._locks.running:
                    await asyncio.wait([pending.verdict for pending in self._locks.running])
        except TimeoutError:
            names = [pending.name for pending in self._locks.running]
            text = f"{' and '.join(names)} has not ended within {ENDING_TIME:g} s after it was stopped."
            raise PcmrsError(text, running=names) from None

    def _show(self, verdict: Verdict) -> None:
        if verdict.decision != "rejected":
            self._show_snapshot()
        if verdict.reason is None or verdict.reason.code != TOO_MANY:  # what is only counted is not told either
            self._publish(verdict)

    def _show_snapshot(self) -> None:
        self._publish(self.snapshot())

    # -- helpers -----------------------------------------------------------------------------------------

    def _submit_posts(self, parent: Command, run: Run[C, D]) -> None:
        for number, (branch, operation, arguments) in enumerate(run.posts):
            self._verdict_of(
                Command(
                    id=f"{parent.id}/{number}",
                    branch=branch,
                    operation=operation,
                    source=f"operation:{parent.source}",
                    user=parent.user,
                    role="daemon",
                    arguments=arguments,
                    parent=parent.id,
                )
            )

    def _remember_missed(self, command: Command, verdict: Verdict) -> None:
        """What a device has said while the journal failed is still true when the procedure goes on."""
        if self._broken is not None and verdict.decision != "accepted" and command.source.startswith("device:"):
            self._missed[command.branch, command.operation] = command

    def _submit_missed(self) -> list[asyncio.Future[Verdict]]:
        missed, self._missed = self._missed, {}
        return [
            self._verdict_of(msgspec.structs.replace(command, id=f"{command.operation}-{uuid.uuid4().hex}"))
            for command in missed.values()
        ]

    def _submit_operations_of(self, event: DeviceEvent) -> list[asyncio.Future[Verdict]]:
        """Submits what follows from an event of a device, and returns the verdicts to come."""
        return [
            self._verdict_of(
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

    def _follow_danger(self, submit: Callable[[], list[asyncio.Future[Verdict]]]) -> list[asyncio.Future[Verdict]]:
        """Submits what follows from danger: no acknowledgement before it is decided.

        What the state does not allow is decided already, and neither runs nor waits.
        """
        following = submit()
        for pending in (*self._locks.running, *self._locks.waiting):
            if pending.verdict in following:
                self._stops.wait_for(pending.name, pending.verdict)
        return following

    async def _hold_or_doubt(self, number: int) -> None:
        await self._take_standstill(number, DAEMON, stands=await self._hold.stop())

    async def _take_standstill(self, number: int, source: str, *, stands: bool) -> None:
        """Confirms Stop `number`, or tells everybody that robot or stimulator have not confirmed that they stand."""
        if stands:
            self._stops.stood(number)
            self._show_snapshot()
        else:
            self.in_doubt = True
            await self._tell(not_confirmed(source))

    def _publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        for publish in self._publishers:
            _guarded(publish, message)

    def _tell(self, event: DeviceEvent) -> QueuedRow:
        """Makes an event known at once; it is durable once what is returned has been awaited."""
        self._publish(event)
        return self._record_event(event)

    def _record_event(self, event: DeviceEvent) -> QueuedRow:
        """Queues an event's row at once, so that what is submitted from now on is journalled after it."""
        return QueuedRow(partial(self._recorder.event, event, self.procedure.promised()), self._break)

    def _break(self, error: BaseException) -> Reason:
        return self.fail(reason_for(error))


def _guarded(callback: Callable[..., object], *arguments: object) -> None:
    """Calls somebody who watches: what fails there is reported by the loop, and keeps nobody from stopping."""
    try:
        callback(*arguments)
    except Exception as error:
        context = {"message": f"{callback} has failed", "exception": error}
        asyncio.get_running_loop().call_exception_handler(context)


async def _all_of(verdicts: list[asyncio.Future[Verdict]]) -> None:
    """Returns when all are given; whoever awaits it may be cancelled, and they are not."""
    if verdicts:
        await asyncio.wait(verdicts)
