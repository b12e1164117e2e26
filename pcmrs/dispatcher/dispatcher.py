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
from pcmrs.dispatcher.attempt import Attempt, locks_for
from pcmrs.dispatcher.lanes import Lanes
from pcmrs.dispatcher.memory import Memory
from pcmrs.dispatcher.perform import Ending, consequence, reason_of, refusal, take_steps
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.recorder import Recorder
from pcmrs.dispatcher.run import C, D, Run
from pcmrs.dispatcher.workflow import Workflow
from pcmrs.errors import JournalError, PcmrsError, ReentrancyError
from pcmrs.fsm import Change, Closure, Denial
from pcmrs.messages import Command, Decision, DeviceEvent, Reason, Running, Snapshot, Verdict

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
        self._broken: Reason | None = None
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
        return await asyncio.shield(self._verdict_of(command))

    async def stop(self, source: str, reason: Reason | None = None) -> None:
        """Stops everything: never queues, wins in every state, latches until acknowledged.

        Returns when every running operation has ended and the hold is confirmed or has failed.
        """
        reason = reason or Reason(code="stopped", text=f"Stopped by {source}.", fields={"source": source})
        holding = self._spawn(self._hold_confirmed())
        self.procedure.latch()
        ending = [attempt.task for attempt in self._lanes.running if attempt.task is not None]
        for attempt in self._lanes.running:
            attempt.stop(reason)
        for attempt in self._lanes.take_waiting():
            self._reject(attempt.command, attempt.verdict, reason)
        event = DeviceEvent(device=source, code=reason.code, text=reason.text, danger=True, fields=reason.fields)
        self._publish(event)
        self._publish(self.snapshot())
        await self._record_event(event)
        await asyncio.wait([holding, *ending])

    async def report(self, event: DeviceEvent) -> None:
        """Takes a device's event: danger goes the way of Stop; then its event operations are submitted."""
        if event.danger:
            await self.stop(f"device:{event.device}", Reason(code=event.code, text=event.text, fields=event.fields))
        else:
            self._publish(event)
            await self._record_event(event)
        joint = self.procedure.joint()
        for name, branch in self._workflow.blueprint.branches.items():
            operation = branch.operations.get(event.code)
            if operation is not None and operation.event and branch.valid_in(event.code, joint[name]):
                command_id = f"{event.code}-{uuid.uuid4().hex}"
                source = f"device:{event.device}"
                await self.submit(Command(id=command_id, branch=name, operation=event.code, source=source))

    async def close(self) -> None:
        """Ends the procedure; whatever runs is stopped first, so that motion is held."""
        if self._lanes.running or self._lanes.waiting:
            await self.stop("shutdown")
        while self._tasks:
            await asyncio.wait(self._tasks)

    # -- from command to attempt -----------------------------------------------------------------------

    def _verdict_of(self, command: Command) -> asyncio.Future[Verdict]:
        try:
            verdict, is_new = self._memory.verdict_of(command)
        except JournalError as error:
            verdict, is_new = asyncio.get_running_loop().create_future(), False
            self._spawn(self._break_off(command, verdict, "rejected", error))
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

    def _barred(self, attempt: Attempt) -> Reason | None:
        if self._broken is None and attempt.moves and self.procedure.latched:
            text = f"{attempt.name} would move, but Stop is latched: acknowledge with robot.acknowledge first."
            return Reason(code="latched", text=text)
        return self._broken

    def _start(self, attempt: Attempt) -> None:
        self._lanes.running.append(attempt)
        attempt.task = self._spawn(self._perform(attempt))

    def _start_waiting(self) -> None:
        """Asks again for everything that waited: it starts, waits on, or is rejected."""
        for attempt in self._lanes.take_waiting():
            answer = self.procedure.ask(attempt.command.branch, attempt.command.operation)
            attempt.locks = locks_for(self._workflow.blueprint, attempt.command, answer)
            reason = self._barred(attempt) or _denied(answer)
            if self._lanes.blocked(attempt):
                self._lanes.waiting.append(attempt)
            elif reason is not None:
                self._reject(attempt.command, attempt.verdict, reason)
            else:
                self._start(attempt)

    # -- from attempt to verdict -----------------------------------------------------------------------

    async def _perform(self, attempt: Attempt) -> None:
        _performing.set(id(self))
        run = self._run_of(attempt)
        try:
            refused = refusal(self._workflow.registry, attempt.spec, run)
            if refused is not None:
                attempt.ending = True
                await self._decide(attempt.command, attempt.verdict, "rejected", refused)
            else:
                await self._end(attempt, run, await self._steps(attempt, run))
        except Exception as error:
            log.exception("dispatcher_broken", command=attempt.command.id)
            attempt.end_steps()
            await self._break_off(attempt.command, attempt.verdict, "unknown", error)
        finally:
            self._lanes.running.remove(attempt)
            self._start_waiting()
        if attempt.verdict.result().decision == "accepted":
            self._submit_posts(attempt.command, run)

    def _run_of(self, attempt: Attempt) -> Run[C, D]:
        def show(fraction: float) -> None:
            attempt.progress = fraction
            self._publish(self.snapshot())

        states, data = self.procedure.joint(), self.procedure.data
        return Run(attempt.command, attempt.payload, states, self._cell, self._clock, data, show)

    async def _steps(self, attempt: Attempt, run: Run[C, D]) -> Ending:
        """Takes the steps, after the intent is durable where they touch the world; holds what failed to move."""
        attempt.begun = True
        try:
            if self._touches_world(attempt):
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

    async def _end(self, attempt: Attempt, run: Run[C, D], ending: Ending) -> None:
        """Gives the verdict that the ending declares."""
        closure = self.procedure.ask(attempt.command.branch, attempt.command.operation)
        if isinstance(closure, Denial):
            raise PcmrsError(f"{closure.text} It was allowed when {attempt.name} began.")
        decision, change, reason = consequence(closure, ending, attempt.name)
        await self._decide(attempt.command, attempt.verdict, decision, reason, attempt, run, change)

    async def _decide(
        self,
        command: Command,
        verdict: asyncio.Future[Verdict],
        decision: Decision,
        reason: Reason | None,
        attempt: Attempt | None = None,
        run: Run[C, D] | None = None,
        change: Change | None = None,
    ) -> None:
        """Journals a decision, then commits it, then publishes it and answers."""
        accepted = decision == "accepted"
        changes = run.changes if run is not None and accepted else {}
        with_intent = attempt is not None and not self._touches_world(attempt)
        sequence = self.procedure.sequence if decision == "rejected" else self.procedure.reserve(change)
        states = self.procedure.joint() | (dict(change.states) if change is not None else {})
        answer = self._verdict(command, decision, reason, states=states, sequence=sequence, run=run)
        try:
            promised = self.procedure.promised()
            await self._recorder.decision(command, answer, promised, changes, with_intent=with_intent)
            if decision != "rejected":
                # A Stop that came while this was journalled is not acknowledged by it.
                unlatch = accepted and attempt is not None and attempt.spec.unlatches and attempt.stopped is None
                self.procedure.commit(sequence, change, changes, unlatch=unlatch)
        except Exception as error:
            await self._break_off(command, verdict, "rejected" if decision == "rejected" else "unknown", error)
        else:
            self._answer(verdict, answer)

    def _answer(self, verdict: asyncio.Future[Verdict], answer: Verdict) -> None:
        self._memory.settle(verdict, answer)
        if answer.decision != "rejected":
            self._publish(self.snapshot())
        self._publish(answer)

    def _verdict(
        self,
        command: Command,
        decision: Decision,
        reason: Reason | None,
        *,
        states: dict[str, str] | None = None,
        sequence: int | None = None,
        run: Run[C, D] | None = None,
    ) -> Verdict:
        states = states or self.procedure.joint()
        state = states.get(command.branch, "")
        return Verdict(
            id=command.id,
            branch=command.branch,
            operation=command.operation,
            decision=decision,
            state=state,
            reason=reason,
            allowed=self.procedure.allowed(command.branch, states) if state else [],
            result=run.result if run is not None and run.result else None,
            sequence=self.procedure.sequence if sequence is None else sequence,
        )

    # -- helpers -----------------------------------------------------------------------------------------

    def _touches_world(self, attempt: Attempt) -> bool:
        return not self._workflow.registry.worldly.isdisjoint(attempt.spec.steps)

    def _reject(self, command: Command, verdict: asyncio.Future[Verdict], reason: Reason) -> None:
        self._spawn(self._decide(command, verdict, "rejected", reason))

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
        try:
            await self._hold()
        except Exception as error:
            log.warning("hold_not_confirmed", reason=str(error))
            return False
        return True

    async def _record_event(self, event: DeviceEvent) -> None:
        try:
            await self._recorder.event(event, self.procedure.promised())
        except JournalError as error:
            await self._break(error)

    async def _break(self, error: Exception) -> None:
        """Fail-stop: the robot is held and nothing is accepted any more; Stop and status still work."""
        if self._broken is None:
            code = error.code if isinstance(error, PcmrsError) else "internal_error"
            text = f"The dispatcher has stopped for safety: {error} Restart the daemon."
            self._broken = Reason(code=code, text=text)
            log.critical("fail_stop", reason=text)
            for attempt in self._lanes.running:
                attempt.stop(self._broken)
            await self._hold_confirmed()

    async def _break_off(
        self, command: Command, verdict: asyncio.Future[Verdict], decision: Decision, error: Exception
    ) -> None:
        """Answers a command that the dispatcher itself could not bring to its end."""
        await self._break(error)
        self._answer(verdict, self._verdict(command, decision, self._broken))

    def _spawn(self, work: Coroutine[Any, Any, Any]) -> asyncio.Task[Any]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task


def _denied(answer: Closure | Denial) -> Reason | None:
    if isinstance(answer, Closure):
        return None
    return Reason(code=answer.code, text=answer.text, fields=answer.fields)
