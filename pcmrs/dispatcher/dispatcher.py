"""The dispatcher (D-SFO): takes commands, asks the active states, performs operations, transitions."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Awaitable, Callable, Coroutine
from contextvars import ContextVar
from typing import Any, Generic

import structlog

from pcmrs.clock import Clock
from pcmrs.dispatcher.admission import check_fresh, find_operation, read_payload
from pcmrs.dispatcher.attempt import Attempt, Locks, locks_for
from pcmrs.dispatcher.decisions import Conclusion, Decisions, reason_for
from pcmrs.dispatcher.lanes import Lanes
from pcmrs.dispatcher.memory import Memory
from pcmrs.dispatcher.perform import (
    Ending,
    consequence,
    reason_of,
    refusal,
    take_steps,
    take_steps_at_once,
)
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.recorder import Recorder
from pcmrs.dispatcher.run import C, D, Run
from pcmrs.dispatcher.workflow import Workflow
from pcmrs.errors import JournalError, PcmrsError, ReentrancyError
from pcmrs.fsm import Closure, Denial
from pcmrs.messages import Command, DeviceEvent, Reason, Running, Snapshot, Verdict

log = structlog.get_logger(__name__)

_performing: ContextVar[int | None] = ContextVar("performing", default=None)


class Dispatcher(Generic[C, D]):
    """Runs one procedure of one cell; every edge of the system ends in `submit` or `stop`.

    Args:
        workflow: The procedure.
        cell: The devices and frames that its operations use.
        clock: The cell's clock.
        recorder: The journal.
        hold: Holds the robot and returns when it stands still; raises when that is not confirmed.
        publish: Called in the event loop with every new snapshot, verdict and device event.

    Attributes:
        in_doubt: A stop's hold has not been confirmed, and nobody has acknowledged the stop since.
    """

    def __init__(
        self,
        workflow: Workflow[C, D],
        cell: C,
        clock: Clock,
        recorder: Recorder,
        hold: Callable[[], Awaitable[object]],
        publish: Callable[[Snapshot | Verdict | DeviceEvent], None],
    ) -> None:
        self.procedure = Procedure(workflow)
        self._workflow = workflow
        self._cell = cell
        self._clock = clock
        self._recorder = recorder
        self._hold = hold
        self._publish = publish
        self._lanes = Lanes(workflow.blueprint.revokers)
        self._memory = Memory(recorder)
        self._decisions = Decisions(self.procedure, recorder, self._memory, self._settle, self._break)
        self._broken: Reason | None = None
        self._stop_listeners: list[Callable[[], None]] = []
        self._holding: asyncio.Task[bool] | None = None
        self.in_doubt = False
        self._tasks: set[asyncio.Task[Any]] = set()

    # -- what the edges of the system call -----------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """The joint state of all branches, and what is running."""
        return self.procedure.snapshot(
            [
                Running(branch=a.command.branch, operation=a.command.operation, id=a.command.id, progress=a.progress)
                for a in self._lanes.running
                if a.begun and not a.verdict.done()
            ]
        )

    async def submit(self, command: Command) -> Verdict:
        """Decides on a command, performs it when it is allowed, and returns the verdict.

        Cancelling the caller does not cancel the operation. A repeat of (source, id) gets the recorded
        verdict, or waits for the one under way, and runs nothing.

        Raises:
            ReentrancyError: An operation awaits its own dispatcher; it may `Run.post` instead.
        """
        if _performing.get() == id(self):
            raise ReentrancyError(f"{command.branch}.{command.operation} was awaited by a running operation: post it.")
        verdict = self._verdict_of(command)
        return verdict.result() if verdict.done() else await asyncio.shield(verdict)

    def on_stop(self, callback: Callable[[], None]) -> None:
        """Has `callback` called synchronously at every stop, whatever way it came."""
        self._stop_listeners.append(callback)

    async def stop(self, source: str, reason: Reason | None = None) -> bool:
        """Stops everything: never queues, wins in every state, latches until acknowledged.

        Returns when every running operation has ended: whether the robot has confirmed that it stands.
        """
        reason = reason or Reason(code="stopped", text=f"Stopped by {source}.", fields={"source": source})
        holding = self._spawn(self._hold_confirmed())
        self.procedure.latch()
        for callback in self._stop_listeners:
            callback()
        ending = [attempt.verdict for attempt in self._lanes.running]
        for attempt in self._lanes.running:
            attempt.stop(reason)
        for attempt in self._lanes.take_waiting():
            self._reject(attempt.command, attempt.verdict, reason)
        event = DeviceEvent(device=source, code=reason.code, text=reason.text, danger=True, fields=reason.fields)
        self._publish(event)
        self._publish(self.snapshot())
        await self._record_event(event)
        await asyncio.wait([holding, *ending])
        confirmed: bool = holding.result()
        if not confirmed:
            await self._doubt(source)
        return confirmed

    async def report(self, event: DeviceEvent) -> None:
        """Takes a device's event: danger goes the way of Stop; then its event operations are submitted."""
        if event.danger:
            await self.stop(f"device:{event.device}", Reason(code=event.code, text=event.text, fields=event.fields))
        else:
            self._publish(event)
            await self._record_event(event)
        for name, branch in self._workflow.blueprint.branches.items():
            operation = branch.operations.get(event.code)
            if operation is not None and operation.event:
                command_id = f"{event.code}-{uuid.uuid4().hex}"
                source = f"device:{event.device}"
                await self.submit(Command(id=command_id, branch=name, operation=event.code, source=source))

    def report_later(self, event: DeviceEvent) -> None:
        """Reports an event without waiting until it is durable."""
        self._spawn(self.report(event))

    async def close(self) -> None:
        """Ends the procedure: the robot is held, whatever runs is stopped, and nothing more is accepted."""
        self._broken = self._broken or Reason(code="ending", text="The daemon is ending.")
        await self.stop("shutdown")
        while self._tasks:
            await asyncio.wait(self._tasks)

    # -- from command to attempt -----------------------------------------------------------------------

    def _verdict_of(self, command: Command) -> asyncio.Future[Verdict]:
        try:
            verdict, is_new = self._memory.verdict_of(command)
        except JournalError as error:
            verdict, is_new = asyncio.get_running_loop().create_future(), False
            self._decisions.break_off(Conclusion(command, verdict, "rejected"), error)
        if is_new:
            self._admit(command, verdict)
        return verdict

    def _admit(self, command: Command, verdict: asyncio.Future[Verdict]) -> None:
        """Turns a command into an attempt that starts, waits or is rejected."""
        try:
            spec = find_operation(self._workflow, command)
            check_fresh(self._clock, command)
            payload = read_payload(self._workflow, command, spec)
        except PcmrsError as error:
            self._reject(command, verdict, reason_of(error))
            return
        answer = self.procedure.ask(command.branch, command.operation)
        attempt = Attempt(command, spec, payload, verdict, locks_for(self._workflow.blueprint, command, answer))
        blocked = self._lanes.blocked(attempt)
        reason = self._barred(attempt) or (self._lanes.why_not_wait(attempt) if blocked else _denied(answer))
        if reason is not None:
            self._reject(command, verdict, reason)
        elif blocked:
            self._lanes.waiting.append(attempt)
        else:
            self._start(attempt)

    def _too_old(self, attempt: Attempt) -> Reason | None:
        try:
            check_fresh(self._clock, attempt.command)
        except PcmrsError as error:
            return reason_of(error)
        return None

    def _barred(self, attempt: Attempt) -> Reason | None:
        if self._broken is None and attempt.spec.halts and self.procedure.latched:
            release = " or ".join(self._workflow.blueprint.unlatching)
            text = f"{attempt.name} is not allowed while Stop is latched: acknowledge with {release} first."
            return Reason(code="latched", text=text)
        return self._broken

    def _start(self, attempt: Attempt) -> None:
        self._lanes.running.append(attempt)
        if self._touches_world(attempt):
            attempt.task = self._spawn(self._perform(attempt))
        else:
            self._perform_at_once(attempt)

    def _start_waiting(self) -> None:
        """Asks again for everything that waited: it starts, waits on, or is rejected."""
        for attempt in self._lanes.take_waiting():
            answer = self.procedure.ask(attempt.command.branch, attempt.command.operation)
            attempt.locks = locks_for(self._workflow.blueprint, attempt.command, answer)
            reason = self._barred(attempt) or self._too_old(attempt) or _denied(answer)
            if self._lanes.blocked(attempt):
                self._lanes.waiting.append(attempt)
            elif reason is not None:
                self._reject(attempt.command, attempt.verdict, reason)
            else:
                self._start(attempt)

    # -- from attempt to conclusion --------------------------------------------------------------------

    def _perform_at_once(self, attempt: Attempt) -> None:
        """Performs an operation that touches nothing outside, from its checks to its conclusion."""
        attempt.begun = attempt.ending = True
        performing = _performing.set(id(self))
        run = self._run_of(attempt)
        try:
            refused = refusal(self._workflow.registry, attempt.spec, run)
            ending = None if refused else take_steps_at_once(self._workflow.registry, attempt.spec, run)
        finally:
            _performing.reset(performing)
        self._conclude(attempt, run, refused, ending)

    async def _perform(self, attempt: Attempt) -> None:
        """Performs an operation that touches the world, as a task of its own."""
        _performing.set(id(self))
        run = self._run_of(attempt)
        try:
            refused = refusal(self._workflow.registry, attempt.spec, run)
            ending = None if refused else await self._steps(attempt, run)
        except Exception as error:
            attempt.end_steps()
            unknown: Conclusion[C, D] = Conclusion(attempt.command, attempt.verdict, "unknown", attempt=attempt)
            self._decisions.break_off(unknown, error)
        else:
            attempt.end_steps()
            await self._let_others_end(attempt)
            self._conclude(attempt, run, refused, ending)

    async def _let_others_end(self, attempt: Attempt) -> None:
        """Waits while other operations run on branches that this one would move now, and did not when it began.

        A retreat does not keep others from changing what its standoff rests on: only here can the two meet.
        """
        attempt.committing = True
        while in_the_way := self._in_the_way(attempt):
            await asyncio.wait([other.verdict for other in in_the_way])

    def _in_the_way(self, attempt: Attempt) -> list[Attempt]:
        closure = self.procedure.ask(attempt.command.branch, attempt.command.operation)
        if isinstance(closure, Denial):
            return []
        beyond = Locks(closure.writes - attempt.locks.writes, frozenset())
        others = (other for other in self._lanes.running if not other.committing)
        return [other for other in others if beyond.conflicts(other.locks)]

    async def _steps(self, attempt: Attempt, run: Run[C, D]) -> Ending:
        """Takes the steps after the intent is durable; holds what has failed to move."""
        attempt.begun = True
        if attempt.moves:
            self._holding = None  # a hold asked for before this motion does not stop it
        try:
            self._publish(self.snapshot())
            await asyncio.shield(self._recorder.intent(attempt.command, run.states))
            ending = Ending("failed", reason=attempt.stopped)
            if attempt.stopped is None:
                ending = await take_steps(self._workflow.registry, attempt.spec, run)
        except asyncio.CancelledError:
            cancelled = Reason(code="step_cancelled", text=f"What {attempt.name} waited for was cancelled.")
            ending = Ending("failed", reason=attempt.stopped or cancelled)
        attempt.end_steps()
        if attempt.moves and ending.kind != "done" and not await self._hold_confirmed():
            return Ending("unknown", reason=ending.reason)
        return ending

    def _run_of(self, attempt: Attempt) -> Run[C, D]:
        def show(fraction: float) -> None:
            attempt.progress = fraction
            self._publish(self.snapshot())

        states, data = self.procedure.joint(), self.procedure.data
        return Run(attempt.command, attempt.payload, states, self._cell, self._clock, data, show)

    def _conclude(self, attempt: Attempt, run: Run[C, D], refused: Reason | None, ending: Ending | None) -> None:
        """Works out what the refusal or the ending means for the states."""
        command, verdict = attempt.command, attempt.verdict
        if ending is None:
            self._decisions.conclude(Conclusion(command, verdict, "rejected", refused, attempt))
            return
        at_once = not self._touches_world(attempt)
        closure = self.procedure.ask(command.branch, command.operation)
        if isinstance(closure, Denial):
            error = PcmrsError(f"{closure.text} It was allowed when {attempt.name} began.")
            self._decisions.break_off(Conclusion(command, verdict, "unknown", attempt=attempt), error)
            return
        decision, change, reason = consequence(closure, ending, attempt.name)
        self._decisions.conclude(Conclusion(command, verdict, decision, reason, attempt, run, change, at_once))

    def _reject(self, command: Command, verdict: asyncio.Future[Verdict], reason: Reason) -> None:
        self._decisions.conclude(Conclusion(command, verdict, "rejected", reason))

    def _settle(self, conclusion: Conclusion[C, D], verdict: Verdict) -> None:
        """The verdict is given: shows it, and lets others have the locks."""
        loop = asyncio.get_running_loop()
        self.in_doubt = self.in_doubt and not conclusion.unlatches
        loop.call_soon(self._show, verdict)  # those who asked hear of it before those who watch
        if conclusion.attempt is not None:
            self._lanes.running.remove(conclusion.attempt)
            if self._lanes.waiting:
                loop.call_soon(self._start_waiting)
        if conclusion.run is not None and verdict.decision == "accepted":
            self._submit_posts(conclusion.command, conclusion.run)

    def _show(self, verdict: Verdict) -> None:
        if verdict.decision != "rejected":
            self._publish(self.snapshot())
        self._publish(verdict)

    # -- helpers -----------------------------------------------------------------------------------------

    def _touches_world(self, attempt: Attempt) -> bool:
        return not self._workflow.registry.worldly.isdisjoint(attempt.spec.steps)

    def _submit_posts(self, parent: Command, run: Run[C, D]) -> None:
        for number, (branch, operation, arguments) in enumerate(run.posts):
            self._verdict_of(
                Command(
                    id=f"{parent.id}/{number}",
                    branch=branch,
                    operation=operation,
                    source=f"operation:{parent.source}",
                    arguments=arguments,
                    parent=parent.id,
                )
            )

    async def _hold_confirmed(self) -> bool:
        """Holds the robot; those who ask while a hold is under way, and nothing has moved since, wait for that one."""

        async def hold() -> bool:
            try:
                await self._hold()
            except Exception as error:
                log.warning("hold_not_confirmed", reason=str(error))
                return False
            return True

        if self._holding is None or self._holding.done():
            self._holding = self._spawn(hold())
        return await asyncio.shield(self._holding)

    async def _doubt(self, source: str) -> None:
        """Tells everybody that a stopped robot has not confirmed that it stands."""
        self.in_doubt = True
        text = "The robot has not confirmed that it stands: look at it, use its own emergency stop."
        event = DeviceEvent(device=source, code="hold_not_confirmed", text=text, danger=True)
        self._publish(event)
        await self._record_event(event)

    async def _record_event(self, event: DeviceEvent) -> None:
        try:
            await self._recorder.event(event, self.procedure.promised())
        except JournalError as error:
            self._break(error)

    def _break(self, error: BaseException) -> Reason:
        """Fail-stop: the robot is held and nothing is accepted any more; Stop and status still work."""
        if self._broken is None:
            self._broken = reason_for(error)
            log.critical("fail_stop", reason=self._broken.text)
            for attempt in self._lanes.running:
                attempt.stop(self._broken)
            self._spawn(self._hold_confirmed())
        return self._broken

    def _spawn(self, work: Coroutine[Any, Any, Any]) -> asyncio.Task[Any]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task


def _denied(answer: Closure | Denial) -> Reason | None:
    if isinstance(answer, Closure):
        return None
    return Reason(code=answer.code, text=answer.text, fields=answer.fields)
