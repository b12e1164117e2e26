"""The dispatcher (D-SFO): takes commands, asks the active states, performs operations, commits transitions.

`Dispatcher` is the surface, and `FollowUp` does what follows from a verdict. Each other idea behind it has a module:
`_admission` (from command to pending command), `_performer` (checks and steps), `decisions` (journal and commit),
`_activities` and `_timers` (what runs while a state is active), `stops` (Stop until the standstill), `recovery`
(failure and resuming).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Container, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Generic

import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.dispatcher._activities import Activities
from pcmrs.dispatcher._admission import CommandAdmission
from pcmrs.dispatcher._performer import Performer
from pcmrs.dispatcher._timers import Timers
from pcmrs.dispatcher.decisions import TOO_MANY, Decisions, Rejections, reason_for
from pcmrs.dispatcher.events import (
    SHUTDOWN,
    CompletedCommand,
    DispatcherListener,
    Listeners,
    QueuedRow,
    Recorder,
    Submission,
)
from pcmrs.dispatcher.execution import Checks, ExecutionContext, Hold, MotionChecker, performing
from pcmrs.dispatcher.lease import Lease
from pcmrs.dispatcher.locks import LockManager, PendingCommand
from pcmrs.dispatcher.next_step import next_step
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.recovery import FailureRecovery, PendingOutcomes, Reconciliation
from pcmrs.dispatcher.stops import StopControl, Stops, StopUnderWay
from pcmrs.dispatcher.verdict_cache import VerdictCache, wait_for_verdicts
from pcmrs.dispatcher.workflow import C, D, Run, Workflow
from pcmrs.errors import ReentrancyError
from pcmrs.messages import Command, DeviceEvent, DryRunResult, NextStep, Reason, Snapshot, UnknownOutcome, Verdict

log = structlog.get_logger(__name__)

ENDING = "ending"
"""Code of the reason why a dispatcher that is being closed accepts nothing more: no failure."""


class FollowUp(Generic[C, D]):
    """Do what follows from a verdict.

    Args:
        context: Shared parts of the dispatcher.
        admission: Admits waiting and posted commands.
        stop_control: Its doubt ends with an acknowledgement.
        recovery: Remembers the reports of devices that a failure has kept from being decided.
        outcomes: Unknown outcomes.
        activities: Follow the states.
        timers: Follow the states and the accepted commands.
    """

    def __init__(
        self,
        context: ExecutionContext[C, D],
        admission: CommandAdmission[C, D],
        stop_control: StopControl[C, D],
        recovery: FailureRecovery[C, D],
        outcomes: PendingOutcomes,
        activities: Activities[C, D],
        timers: Timers[C, D],
    ) -> None:
        self._coordinator = context.coordinator
        self._clock = context.clock
        self._locks = context.locks
        self._admission = admission
        self._stop_control = stop_control
        self._recovery = recovery
        self._outcomes = outcomes
        self._activities = activities
        self._timers = timers
        self._listeners = context.listeners

    def on_completed(self, completed: CompletedCommand[C, D], verdict: Verdict) -> None:
        """Publish a verdict that has been given, and release the locks, whatever fails of what follows from it.

        Args:
            completed: The completed command.
            verdict: The verdict on it.
        """
        if verdict.decision == "accepted":
            self._listeners.notify_accepted(completed.command)
        loop = asyncio.get_running_loop()
        # The requester receives it before those who watch: its task runs in the second turn of the loop from now,
        # because of the shield in `Dispatcher.submit`.
        loop.call_soon(loop.call_soon, self._coordinator.publish_verdict, verdict)
        if completed.pending is not None:
            self._locks.running.remove(completed.pending)
            if self._locks.waiting:
                loop.call_soon(self._admission.admit_waiting)
        try:
            self._follow(completed, verdict)
        except Exception as error:
            log.exception("verdict_not_followed", command=verdict.id)
            self._coordinator.fail_for(error)

    def _follow(self, completed: CompletedCommand[C, D], verdict: Verdict) -> None:
        control = self._stop_control
        control.in_doubt = control.in_doubt and not completed.unlatches
        self._outcomes.follow(completed.command, verdict, self._clock.wall())
        self._activities.follow(completed.command)
        self._timers.follow(completed.command, verdict)
        self._recovery.remember_missed(completed.command, verdict)
        if completed.run is not None and verdict.decision == "accepted":
            self._submit_posts(completed.command, completed.run)

    def _submit_posts(self, parent: Command, run: Run[C, D]) -> None:
        for number, (branch, operation, arguments) in enumerate(run.posts):
            self._admission.admit(
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


class Dispatcher(Generic[C, D]):
    """Run one procedure of one cell; every edge of the system ends in `submit` or `stop`.

    Args:
        workflow: The procedure.
        cell: The devices and frames that its operations use.
        clock: The cell's clock.
        recorder: The journal.
        hold: Holds the robot, latches it if its argument is true, and returns when the robot stands still; raises if
            that is not confirmed.
        release: Ends the latch of the devices for an operation that acknowledges a Stop, and returns the names of
            those that stay latched. Its argument is true if Stop is latched now. It raises if the robot does not
            stand. None for devices that Stop does not latch.
        lease_required: True if somebody must hold the cell before commands are taken.
        planner: Asks the checks that plan motions; without one they are asked in the event loop.
        rejections: Decides which rejections get a row; without it all get one.
        limits: The configuration's ``procedure.limits``, for the timers that name one of them; those that it lacks are
            the workflow's defaults.

    Raises:
        ConfigurationError: A limit that a timer names cannot be its time.

    Attributes:
        procedure: States, flags and data of the procedure.
    """

    def __init__(
        self,
        workflow: Workflow[C, D],
        cell: C,
        clock: Clock,
        recorder: Recorder,
        hold: Callable[[bool], Awaitable[object]],
        *,
        release: Callable[[bool], Awaitable[Sequence[str]]] | None = None,
        lease_required: bool = False,
        planner: MotionChecker[C, D] | None = None,
        rejections: Rejections | None = None,
        limits: Mapping[str, float] | None = None,
    ) -> None:
        self.procedure = Procedure(workflow)
        self._recorder = recorder
        self._rejections = rejections
        if rejections is not None:
            rejections.attach(self)
        self._tasks = BackgroundTasks(self._on_task_failure)
        self._locks = LockManager(workflow.blueprint.revokers)
        self._listeners = Listeners()
        self._stops = Stops(clock)
        self._outcomes = PendingOutcomes(workflow.blueprint)
        context = ExecutionContext(
            workflow=workflow,
            procedure=self.procedure,
            cell=cell,
            clock=clock,
            hold=Hold(hold, self._tasks),
            tasks=self._tasks,
            locks=self._locks,
            listeners=self._listeners,
            coordinator=self,
            release=release,
        )
        verdicts = VerdictCache(recorder)
        decisions = Decisions(self.procedure, recorder, verdicts, self, rejections)
        self._activities = activities = Activities(context)
        self._timers = timers = Timers(context, decisions, limits or {})
        self._performer = Performer(context, decisions, recorder, activities, Checks(context, planner))
        lease = Lease(clock, required=lease_required)
        self._admission = CommandAdmission(
            context, lease, self._stops, verdicts, decisions, self._performer, activities
        )
        self._stop_control = StopControl(context, self._stops, decisions, activities)
        reconciliation = Reconciliation(self.procedure, verdicts, decisions, self._outcomes, activities, timers)
        self._recovery = FailureRecovery(
            context, recorder, self._admission, self._stop_control, activities, timers, reconciliation
        )
        self._follow_up = FollowUp(
            context, self._admission, self._stop_control, self._recovery, self._outcomes, activities, timers
        )

    # -- state and listeners -------------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """Return the joint state of all branches, with running operations and activities."""
        running = [pending.shown for pending in self._locks.running if pending.started and not pending.verdict.done()]
        activities, unknown = self._activities.shown(), self._outcomes.shown()
        return self.procedure.snapshot(running, activities, unknown, self.lease.state, self._stops.state)

    def next_step(self, operation: str = "") -> NextStep:
        """Return the way on from the present states.

        Args:
            operation: Operation to reach, ``branch.operation``; empty for the next stage of the procedure.
        """
        procedure = self.procedure
        stop = self.stop_number if procedure.latched else None
        return next_step(procedure.guide, procedure.joint(), stop=stop, operation=operation)

    @property
    def lease(self) -> Lease:
        """Lease of the cell."""
        return self._admission.lease

    @property
    def broken(self) -> Reason | None:
        """Why nothing is accepted any more; None in operation."""
        return self._admission.broken

    @property
    def in_doubt(self) -> bool:
        """True if the hold of a Stop or a failure was not confirmed, and this has not been acknowledged since."""
        return self._stop_control.in_doubt

    @property
    def waiting(self) -> int:
        """Number of commands that wait for others to end."""
        return len(self._locks.waiting)

    @property
    def stop_number(self) -> int:
        """Number of the newest Stop; 0 before the first one."""
        return self._stops.state.number

    @property
    def idle(self) -> bool:
        """True if nothing moves the robot, nor brakes it after a Stop: then its joints must not move."""
        return self._stops.standing and not self._admission.moving

    @property
    def moving(self) -> bool:
        """True while something moves the robot, or a motion waits."""
        return self._admission.moving

    @property
    def only_retreats(self) -> bool:
        """True if everything that moves the robot is a retreat; also if nothing does."""
        return self._admission.only_retreats

    def add_listener(self, listener: DispatcherListener) -> None:
        """Notify a listener, too, from now on."""
        self._listeners.add(listener)

    # -- commands and events -------------------------------------------------------------------------------

    def restore(self, *, latched: bool, unknown: Iterable[UnknownOutcome], start: int = 0) -> None:
        """Take over what an earlier run has left for an operator to settle; before anything is submitted.

        Args:
            latched: A Stop of the earlier run has not been acknowledged.
            unknown: Outcomes that are not known.
            start: Number that grows with each run of the daemon: Stops are numbered from it.
        """
        self._stops.number_from(start)
        for outcome in unknown:
            self._outcomes.add(outcome)
        if latched:
            self._stop_control.latch()

    async def submit(self, command: Command, *, arrived: float | None = None) -> Verdict:
        """Decide on a command, perform it if it is allowed, and return the verdict.

        Cancelling the caller does not cancel the operation. A repeat of (source, id) gets the recorded
        verdict, or waits for the pending one, and runs nothing.

        Args:
            command: The command.
            arrived: Time of its arrival at the edge of the daemon, s of the event loop's clock; by default now.

        Raises:
            ReentrancyError: An operation awaits its own dispatcher; it may `Run.post` instead.
        """
        if performing.get() == id(self.procedure):
            raise ReentrancyError(f"{command.branch}.{command.operation} was awaited by a running operation: post it.")
        verdict = self._admission.admit(command, arrived)
        return verdict.result() if verdict.done() else await asyncio.shield(verdict)

    async def dry_run(self, command: Command) -> DryRunResult:
        """Return what the verdict on a command would rest on now: nothing is performed, changed or journalled.

        While the arm moves no check is asked, since each takes time from the control of the arm. Dry runs are made
        one at a time, so that a motion never waits for more than one of them.
        """
        return await self._admission.dry_run(command)

    def suspend(self, reason: Reason | None) -> None:
        """Reject commands for `reason` until called again with None; Stop, events and what runs go on.

        A retreat is allowed, and the release of Stop for it: nobody may be kept from leaving the patient.

        Such a rejection leaves no row: a repeat of the command is decided again when commands are accepted again.
        """
        self._admission.suspended = reason

    def bar_motion(self, reason: Reason | None) -> None:
        """Reject commands that move towards the patient or act on it for `reason` until called again with None.

        A retreat is allowed, and what runs goes on.
        """
        self._admission.motion_barred = reason

    async def report(self, event: DeviceEvent) -> None:
        """Take a device's event: danger stops everything; its event operations are submitted at once."""
        self.lease.follow(event)
        if event.danger:
            await asyncio.shield(self.begin_stop_for(event))
            return
        announced = self.announce(event)
        following = self._admission.admit_event(event)
        await announced
        await wait_for_verdicts(following)

    def report_later(self, event: DeviceEvent) -> None:
        """Report an event without waiting until it is durable."""
        self._tasks.spawn(self.report(event))

    # -- Stop, failure and end -------------------------------------------------------------------------------

    async def stop(self, source: str, reason: Reason | None = None, then: Submission = list) -> bool:
        """Stop everything: never queues, wins in every state, latches until acknowledged.

        Args:
            source: Who stops.
            reason: Why; by default that `source` has requested it.
            then: Submits what follows from a danger event, before anything is awaited, and returns the verdicts to
                come: nobody can acknowledge or move before what has happened is taken into account.

        Returns:
            Whether the robot has confirmed that it stands, when every running operation, and every activity that
            moves, has ended.
        """
        return await asyncio.shield(self.begin_stop(source, reason, then))

    def begin_stop(self, source: str, reason: Reason | None = None, then: Submission = list) -> asyncio.Task[bool]:
        """Begin to stop everything; see `stop`.

        When this returns, the Stop has its number, the latch is set and the holds are on their way.

        Args:
            source: Who stops.
            reason: Why; by default that `source` has requested it.
            then: Submits the operations that follow from a danger event, before anything is awaited.

        Returns:
            A task. Its result is whether the robot has confirmed that it stands.
        """
        return self._stop_control.begin(source, reason, then)

    def begin_stop_for(self, event: DeviceEvent, then: Submission = list) -> asyncio.Task[bool]:
        """Begin to stop everything for a danger event, and submit its event operations; see `begin_stop`.

        Args:
            event: The event.
            then: Submits further operations that follow from it, before anything is awaited.
        """
        reason = Reason(code=event.code, text=event.text, fields=event.fields)
        source = f"device:{event.device}"
        return self.begin_stop(source, reason, lambda: [*self._admission.admit_event(event), *then()])

    def press_stop(self, source: str, presses: int = 1) -> StopUnderWay:
        """Stop for a person; see `begin_stop`.

        A press that meets a pending Stop of the same source joins that Stop, unless something has started since: it is
        counted, and its answer is that Stop's.

        Args:
            source: Who stops.
            presses: Number of presses of this source since the last call.
        """
        return self._stop_control.press(source, presses)

    def fail(self, reason: Reason) -> Reason:
        """Fail-stop: the robot is held, Stop is latched, nothing is accepted any more; Stop and status still work.

        Returns:
            Why nothing is accepted: `reason`, unless there is an earlier failure that counts as much.
        """
        return self._recovery.fail(reason)

    async def resume(self, in_flight: Container[tuple[str, str]]) -> None:
        """Resume after a failure of the journal: held, latched, and with what the disk says.

        What was being journalled at the failure is committed if the disk has it. A command that had begun is
        `unknown`, with the state that its operation declares for that. Anything else counts as never submitted.

        Args:
            in_flight: Source and id of the commands of which the journal has the intent and no outcome.

        Raises:
            PcmrsError: It was not the journal that failed: memory is not to be trusted. Or something still runs.
            JournalError: The journal has failed again.
        """
        await self._recovery.resume(in_flight)

    async def close(self) -> None:
        """End the procedure: the robot is held, running operations are stopped, and nothing more is accepted."""
        self._admission.broken = Reason(code=ENDING, text="The daemon is ending.")
        self._activities.close()
        self._timers.close()
        if self._rejections is not None:
            self._rejections.report()
        await self.stop(SHUTDOWN)
        await self._tasks.wait()

    # -- `Coordinator`, for its parts --------------------------------------------------------------------------

    def admit(self, command: Command) -> asyncio.Future[Verdict]:
        return self._admission.admit(command)

    def objection(self, pending: PendingCommand) -> Reason | None:
        return self._admission.objection(pending)

    def fail_for(self, error: BaseException) -> Reason:
        return self.fail(reason_for(error))

    def on_completed(self, completed: CompletedCommand[C, D], verdict: Verdict) -> None:
        self._follow_up.on_completed(completed, verdict)

    def publish_verdict(self, verdict: Verdict) -> None:
        if verdict.decision != "rejected":
            self.publish_snapshot()
        if verdict.reason is None or verdict.reason.code != TOO_MANY:  # a rejection that is only counted is not shown
            self._listeners.publish(verdict)

    def publish_snapshot(self) -> None:
        self._listeners.publish(self.snapshot())

    def announce(self, event: DeviceEvent) -> QueuedRow:
        self._listeners.publish(event)
        return self.record(event)

    def announce_later(self, event: DeviceEvent) -> None:
        self._tasks.spawn(self.announce(event).durable())

    def record(self, event: DeviceEvent) -> QueuedRow:
        return QueuedRow(partial(self._recorder.event, event, self.procedure.promised()), self.fail_for)

    def _on_task_failure(self, _task: asyncio.Task[Any], error: BaseException) -> None:
        log.error("dispatcher_task_failed", exc_info=error)
        self.fail_for(error)
