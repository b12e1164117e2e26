"""Execution of operations: their checks, in the event loop or by a planner, and their steps under a deadline."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Generic, Literal, Protocol, runtime_checkable

import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.dispatcher.events import Coordinator, Listeners
from pcmrs.dispatcher.locks import LockManager, PendingCommand
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.workflow import C, D, Registry, Run, Workflow
from pcmrs.errors import DeviceError, PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.fsm import START_OUTCOME, Change, Closure, OperationSpec
from pcmrs.messages import Decision, Reason

log = structlog.get_logger(__name__)

performing: ContextVar[int | None] = ContextVar("performing", default=None)
"""Id of the procedure for which the present task runs checks, steps or an activity."""


class Hold:
    """Make the devices stand still, and know whether that was confirmed.

    A Stop while the hold of another Stop is pending waits for that hold: nothing can start to move in between, since
    the latch is set and cannot be released before. The hold of a motion is never merged with another one, since the
    request of that motion may still be on its way: only a hold that is sent after it outdates it.

    Args:
        hold: Holds the robot, latches it if its argument is true, and returns when it stands; raises if that is not
            confirmed.
        tasks: Owner of the holds, which go on when those who wait for them are cancelled.
    """

    def __init__(self, hold: Callable[[bool], Awaitable[object]], tasks: BackgroundTasks) -> None:
        self._hold = hold
        self._tasks = tasks
        self._stopping: asyncio.Task[bool] | None = None

    def stop(self) -> asyncio.Task[bool]:
        """Hold and latch; return a task whose result is whether the robot has confirmed that it stands."""
        if self._stopping is None or self._stopping.done():
            self._stopping = self._tasks.spawn(self._try(latch=True))
        return self._stopping

    async def end_motion(self) -> bool:
        """Hold the robot after a motion; return whether it has confirmed that it stands."""
        return await asyncio.shield(self._tasks.spawn(self._try(latch=False)))

    async def _try(self, *, latch: bool) -> bool:
        try:
            await self._hold(latch)
        except Exception as error:
            log.warning("hold_not_confirmed", reason=str(error))
            return False
        return True


@dataclass(frozen=True)
class ExecutionContext(Generic[C, D]):
    """Parts of one dispatcher that the others share.

    Attributes:
        workflow: The workflow as it was written.
        procedure: Its present state.
        cell: The devices and frames that operations and activities use.
        clock: The cell's clock.
        hold: Holds the robot.
        tasks: Owner of all tasks of the dispatcher.
        locks: Running and waiting commands.
        listeners: Those who listen to the dispatcher.
        coordinator: The dispatcher.
        release: Releases the devices that Stop has latched; see `Dispatcher`.
    """

    workflow: Workflow[C, D]
    procedure: Procedure[C, D]
    cell: C
    clock: Clock
    hold: Hold
    tasks: BackgroundTasks
    locks: LockManager
    listeners: Listeners
    coordinator: Coordinator[C, D]
    release: Callable[[bool], Awaitable[Sequence[str]]] | None


class MotionChecker(Protocol[C, D]):
    """Ask the checks of operations that plan motions."""

    async def check(self, run: Run[C, D], checks: Sequence[str], within: float | None = None) -> Reason | None:
        """Ask checks of a run, and store their results in the run.

        Args:
            run: Argument of the checks.
            checks: Their registered names.
            within: Limit of the wait for the answer, s of the machine; None for that of the planner.

        Returns:
            The first refusal, or why the planner has no answer; None when all agree.
        """


@runtime_checkable
class PlannedMotion(Protocol):
    """Motion that a check has planned: a `JointTrajectory`, or several.

    Attributes:
        stops: Places on the way where the arm rests; empty unless it moves in segments.
        duration: Longest duration of the motion, s.
    """

    @property
    def stops(self) -> Sequence[int]: ...

    @property
    def duration(self) -> float: ...


@dataclass(frozen=True, slots=True)
class StepResult:
    """Result of the steps: ``done`` with an outcome, ``failed`` or ``unknown`` with a reason."""

    kind: Literal["done", "failed", "unknown"]
    outcome: str = START_OUTCOME
    reason: Reason | None = None


def refusal(registry: Registry[C, D], checks: Sequence[str], run: Run[C, D]) -> Reason | None:
    """Run checks; return the first refusal, or None if all agree.

    Args:
        registry: Checks by name.
        checks: Names of the checks to run, in order.
        run: Argument of the checks.
    """
    for name in checks:
        try:
            registry.checks[name](run)
        except PcmrsError as error:
            return reason_of(error, check=name)
        except Exception:
            log.exception("check_raised", check=name, command=run.command.id)
            return Reason(code="check_raised", text=f"Check {name} could not be completed.", fields={"check": name})
    return None


async def take_steps(registry: Registry[C, D], spec: OperationSpec, run: Run[C, D]) -> StepResult:
    """Take the steps of an operation in order and within its time limit; cancellation passes through to the caller.

    Args:
        registry: Steps by name.
        spec: The operation.
        run: Argument of the steps.
    """
    step, limit = "", _time_limit(spec, run)
    try:
        async with run.clock.timeout(limit):
            for step in spec.steps:
                taken = registry.steps[step](run)
                if inspect.isawaitable(taken):
                    await taken
                _raise_if_cancelled()
    except TimeoutError:
        text = f"Step {step} did not end within {limit:g} s."
        fields = {"step": step, "timeout": limit}
        return StepResult("failed", reason=Reason(code="deadline_passed", text=text, fields=fields))
    except Exception as error:
        return _ending_by(error, step, run)
    return StepResult("done", outcome=run.outcome or START_OUTCOME)


def _time_limit(spec: OperationSpec, run: Run[C, D]) -> float:
    """Return the limit of the steps, s; the planned duration of motions in segments comes in addition."""
    planned = run.prepared
    in_segments = isinstance(planned, PlannedMotion) and bool(planned.stops)
    return spec.timeout_s + (planned.duration if in_segments else 0.0)


def take_steps_at_once(registry: Registry[C, D], spec: OperationSpec, run: Run[C, D]) -> StepResult:
    """Take the steps of an operation without side effects: there is nothing to wait for.

    Args:
        registry: Steps by name.
        spec: The operation.
        run: Argument of the steps.
    """
    step = ""
    try:
        for step in spec.steps:
            registry.steps[step](run)
    except Exception as error:
        return _ending_by(error, step, run)
    return StepResult("done", outcome=run.outcome or START_OUTCOME)


def _ending_by(error: Exception, step: str, run: Run[C, D]) -> StepResult:
    if isinstance(error, UnknownOutcomeError):
        return StepResult("unknown", reason=reason_of(error, step=step))
    if isinstance(error, PcmrsError):
        return StepResult("failed", reason=reason_of(error, step=step))
    log.error("step_raised", step=step, command=run.command.id, exc_info=error)
    text = f"Step {step} raised an error; the log has it."
    return StepResult("failed", reason=Reason(code="step_raised", text=text, fields={"step": step}))


def _raise_if_cancelled() -> None:
    """End the steps if the last one has swallowed the cancellation of Stop or of the deadline."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


def consequence(closure: Closure, ending: StepResult, name: str) -> tuple[Decision, Change | None, Reason | None]:
    """Return the decision, the change to commit and the reason that follow from the result of the steps.

    Args:
        closure: Closure of the operation in the present states.
        ending: Result of the steps.
        name: Branch and operation.
    """
    if ending.kind == "unknown":
        return "unknown", closure.unknown, ending.reason
    if ending.kind == "failed":
        return "failed", closure.failure, ending.reason
    if ending.outcome not in closure.outcomes:
        text = f"{name} ended as {ending.outcome!r}; only {list(closure.outcomes)} can be taken now."
        return "failed", closure.failure, Reason(code="undeclared_outcome", text=text)
    return "accepted", closure.outcomes[ending.outcome], None


def reason_of(error: PcmrsError, **where: str) -> Reason:
    """Return the reason that a verdict gives for an error, with `where` among its fields."""
    code = error.refusal_code if isinstance(error, RefusalError) else error.code
    if isinstance(error, DeviceError) and "code" in error.fields:
        code = str(error.fields["code"])
    return Reason(code=code, text=error.text, fields={**error.fields, **where})


MOST_PLANS = 3
"""Limit of plans for one motion if states or data change meanwhile; then the command is rejected."""


class Checks(Generic[C, D]):
    """Ask checks; after a planner has answered, verify that states and data are still the same.

    Args:
        context: Shared parts of the dispatcher.
        planner: Asks the checks that plan a motion; None to ask all of them in the event loop.
    """

    def __init__(
        self,
        context: ExecutionContext[C, D],
        planner: MotionChecker[C, D] | None,
    ) -> None:
        self._context = context
        self._planner = planner
        self._registry = context.workflow.registry

    def take_time(self, spec: OperationSpec) -> bool:
        """Return whether the planner asks the checks of an operation, so that they must be awaited."""
        return self._planner is not None and not self._registry.lasting.isdisjoint(spec.checks)

    def ask_at_once(self, spec: OperationSpec, run: Run[C, D]) -> Reason | None:
        """Return the first refusal of the checks, asked in the event loop; None if all agree.

        Args:
            spec: The operation.
            run: Argument of the checks.
        """
        return refusal(self._registry, spec.checks, run)

    async def ask(self, pending: PendingCommand, run_of: Callable[[], Run[C, D]]) -> tuple[Run[C, D], Reason | None]:
        """Return a run with the results of its checks, and why it is refused; None if it is not.

        Args:
            pending: The command whose checks are asked.
            run_of: Makes a run of it from the present states and data.
        """
        run = run_of()
        if self._planner is None or not self.take_time(pending.spec):
            return run, self.ask_at_once(pending.spec, run)
        for _ in range(MOST_PLANS):
            refused = pending.stopped or await self._plan(pending, run)
            objection = pending.stopped or self._context.coordinator.objection(pending)
            if objection is not None or self._still_true(run):
                return run, objection or refused
            run = run_of()
        text = f"The states or data for {pending.name} changed {MOST_PLANS} times while it was planned: ask again."
        return run, Reason(code="changed_while_planning", text=text, fields={"limit": MOST_PLANS})

    async def ask_again(self, spec: OperationSpec, run: Run[C, D]) -> Reason | None:
        """Ask the checks of a running operation again with the present data; its branches are locked.

        Args:
            spec: The operation.
            run: Its run.
        """
        return await self._answer(spec.checks, run, None)

    async def ask_in_step(self, pending: PendingCommand, run: Run[C, D], check: str, within: float) -> Reason | None:
        """Ask one check for a step of a running operation, and verify afterwards that the next motion is still allowed.

        Args:
            pending: The running command.
            run: Its run.
            check: Registered name of the check.
            within: Limit of the wait for a planner, s of the machine.

        Returns:
            The refusal, or why the motion must not begin although the check agrees; None if it may.
        """
        before = run.data  # on which the question rests
        refused = await self._answer([check], run, within)
        objection = pending.stopped or self._context.coordinator.objection(pending)
        if objection is not None or refused is not None:
            return objection or refused
        data = self._context.procedure.data
        if (data.plan_id, data.registration_id) == (before.plan_id, before.registration_id):
            return None
        text = f"Plan or registration changed while the next motion of {pending.name} was planned: back off."
        return Reason(code="changed_while_planning", text=text)

    async def _answer(self, checks: Sequence[str], run: Run[C, D], within: float | None) -> Reason | None:
        """Return the first refusal, by the planner if there is one and one of the checks takes long."""
        if self._planner is None or self._registry.lasting.isdisjoint(checks):
            return refusal(self._registry, checks, run)
        try:
            return await self._planner.check(run, checks, within)
        except Exception:
            log.exception("planner_raised", command=run.command.id)
            return Reason(
                code="check_raised", text="Its checks could not be completed by the planner; the log has why."
            )

    async def _plan(self, pending: PendingCommand, run: Run[C, D]) -> Reason | None:
        pending.planning = asyncio.ensure_future(self.ask_again(pending.spec, run))
        try:
            await asyncio.wait([pending.planning])
            if pending.planning.cancelled():
                text = f"The planning of {pending.name} was cancelled."
                return pending.stopped or Reason(code="step_cancelled", text=text)
            return pending.planning.result()
        finally:
            pending.planning.cancel()
            pending.planning = None

    def _still_true(self, run: Run[C, D]) -> bool:
        procedure = self._context.procedure
        return run.states == procedure.joint() and run.data == procedure.data
