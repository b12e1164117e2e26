"""Activities: started by the commit that enters their state, ended by the one that leaves it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterable
from typing import Any, Generic

import structlog

from pcmrs.dispatcher.events import ACTIVITY_ENDED, ACTIVITY_STARTED, NOT_CONFIRMED
from pcmrs.dispatcher.execution import ExecutionContext, performing, reason_of
from pcmrs.dispatcher.workflow import Activity, C, D
from pcmrs.errors import PcmrsError
from pcmrs.fsm.blueprint import ActivitySpec
from pcmrs.messages import ActiveActivity, Command, DeviceEvent, Reason, Verdict

log = structlog.get_logger(__name__)


class ActivityTask(Generic[C, D]):
    """Run the function of an activity until it ends or is cancelled.

    Args:
        context: Shared parts of the dispatcher.
        spec: Declaration of the activity.
        act: Argument of the function.

    Attributes:
        task: Task that attends to the activity. Its result is true if the robot stands, or a motion moves it.
        ending: The activity was ended, or kept from starting.
        relieved: A motion takes over from it.
        left: The verdict on its `ended`, once that is submitted.
        quiet: Set when it does nothing any more. If it moved the robot and no motion takes over, the robot has been
            held by then.
    """

    def __init__(self, context: ExecutionContext[C, D], spec: ActivitySpec, act: Activity[C, D]) -> None:
        self.spec = spec
        self.act = act
        self.task: asyncio.Task[bool] | None = None
        self.ending = spec.moves and context.procedure.latched
        self.relieved = False
        self.left: asyncio.Future[Verdict] | None = None
        self.quiet = asyncio.Event()
        self._context = context
        self._coordinator = context.coordinator
        self._function: asyncio.Task[Exception | None] | None = None
        self._started = False

    @property
    def goes_on(self) -> bool:
        """True while it runs or is about to."""
        return not self.ending and not self.quiet.is_set()

    @property
    def stopped(self) -> bool:
        """True if Stop has ended it, or kept it from starting."""
        return self.ending and self._context.procedure.latched

    def end(self) -> None:
        """Cancel its function, once: a second cancellation would interrupt the end of its motion."""
        if self._function is not None and not self.ending:
            self._function.cancel()
        self.ending = True

    async def run(self, before: Iterable[ActivityTask[C, D]]) -> Reason | None:
        """Run it as soon as the activities of `before` are quiet; return why its end is dangerous, or None."""
        try:
            for earlier in before:
                await earlier.quiet.wait()
            danger = None if self.ending else await self._perform()
            if danger is None and self.spec.moves and not self.relieved:
                danger = await self._held()
            return danger
        finally:
            self.quiet.set()

    def announce_end(self, danger: Reason | None) -> Awaitable[None] | None:
        """Announce its end at once, if it had started; awaiting the result returns when the row is durable."""
        if not self._started:
            return None
        how = danger.text if danger is not None else "it was cancelled."
        return self._coordinator.announce(self._event(ACTIVITY_ENDED, f"{self.act.name} has ended: {how}"))

    async def _perform(self) -> Reason | None:
        """Perform its function as soon as its start is durable."""
        act = self.act
        self._started = True
        started = self._event(ACTIVITY_STARTED, f"{act.name} begins: {act.branch} is {act.state}.")
        await self._coordinator.announce(started)
        if self.ending:
            return None
        self._function = self._context.tasks.spawn(self._within())
        await asyncio.wait([self._function])
        return self._danger(self._function)

    async def _within(self) -> Exception | None:
        performing.set(id(self._context.procedure))
        try:
            await self._context.workflow.registry.activities[self.act.name](self.act)
        except Exception as error:
            return error
        return None

    def _danger(self, function: asyncio.Task[Exception | None]) -> Reason | None:
        """Why the end of the function is dangerous: nobody has cancelled it, or it has failed."""
        act = self.act
        error = None if function.cancelled() else function.result()
        if error is not None and not isinstance(error, PcmrsError):
            log.error("activity_raised", activity=act.name, exc_info=error)
        if self.stopped or (error is None and self.ending):
            return None  # at Stop the hold may have made it fail before it was cancelled
        if isinstance(error, PcmrsError):
            return reason_of(error, activity=act.name)
        code, how = ("activity_raised", "raised an error; the log has it") if error else ("activity_ended", "ended")
        text = f"{act.name} has {how} by itself while {act.branch} was {act.state}."
        return Reason(code=code, text=text, fields={"activity": act.name})

    async def _held(self) -> Reason | None:
        """Hold the robot after it was moved; return the danger if that is not confirmed."""
        if await self._context.hold.end_motion():
            return None
        text = f"The robot has not confirmed that it stands after {self.act.name}: look at it."
        return Reason(code=NOT_CONFIRMED, text=text)

    def _event(self, code: str, text: str) -> DeviceEvent:
        act = self.act
        fields: dict[str, Any] = {"branch": act.branch, "state": act.state, "command": act.command.id}
        return DeviceEvent(device=act.source, code=code, text=text, fields=fields)


class Activities(Generic[C, D]):
    """Activities of the states that the branches are in.

    An activity that ends by itself is a danger: it stops everything, then its `ended` is performed. One that moves the
    robot gives way to a motion, ends with Stop, and is followed by a hold in all other cases.

    Args:
        context: Shared parts of the dispatcher.
    """

    def __init__(self, context: ExecutionContext[C, D]) -> None:
        self._context = context
        self._coordinator = context.coordinator
        branches = context.workflow.blueprint.branches
        self._declared = {name: branch.activities for name, branch in branches.items() if branch.activities}
        self._current: dict[str, ActivityTask[C, D]] = {}
        self._tasks: list[ActivityTask[C, D]] = []
        self._closed = False

    def shown(self) -> list[ActiveActivity]:
        """Activities as the snapshot shows them."""
        acts = (each.act for each in self._current.values() if each.goes_on)
        return [ActiveActivity(branch=act.branch, state=act.state, name=act.name, values=act.values) for act in acts]

    def follow(self, command: Command) -> None:
        """End the activities of states that have been left, and start those of states that `command` has entered."""
        joint = self._context.procedure.joint() if self._declared else {}
        for branch, declared in self._declared.items():
            state, current = joint[branch], self._current.get(branch)
            if current is not None and current.act.state != state:
                del self._current[branch]
                current.end()
            if state in declared and branch not in self._current and not self._closed:
                self._begin(declared[state], branch, state, command)

    async def yield_to_motion(self) -> None:
        """End the activities that move the robot, for a motion to take over; return when they are quiet."""
        moving = [each for each in self._tasks if each.spec.moves]
        for each in moving:
            each.relieved = True
            each.end()
        for each in moving:
            await each.quiet.wait()

    @property
    def moving(self) -> bool:
        """True while an activity moves the robot."""
        return any(each.spec.moves and not each.quiet.is_set() for each in self._tasks)

    def end_moving(self) -> list[asyncio.Task[bool]]:
        """End those that move the robot, because of Stop; return their tasks to wait for, see `ActivityTask.task`."""
        moving = [each for each in self._tasks if each.spec.moves and not each.quiet.is_set()]
        for each in moving:
            each.end()
        return [each.task for each in moving if each.task is not None]

    def close(self) -> None:
        """End all; none starts any more, and no command follows."""
        self._closed = True
        for each in self._tasks:
            each.end()

    def open(self) -> None:
        """Allow activities to start again after `close`."""
        self._closed = False

    async def leave_ended(self) -> None:
        """Perform the `ended` of those that `close` has ended, if their branch is still in their state."""
        for each in [each for each in self._current.values() if each.quiet.is_set()]:
            await self._leave(each)

    def _begin(self, spec: ActivitySpec, branch: str, state: str, command: Command) -> None:
        context, procedure = self._context, self._context.procedure
        act = Activity(
            name=spec.run,
            branch=branch,
            state=state,
            command=command,
            cell=context.cell,
            clock=context.clock,
            _data=lambda: procedure.data,
            _states=procedure.joint,
            _submit=self._coordinator.admit,
            _show=self._coordinator.publish_snapshot,
        )
        before = [each for each in self._tasks if each.act.branch == branch]
        activity_task = ActivityTask(context, spec, act)
        self._current[branch] = activity_task
        self._tasks.append(activity_task)
        activity_task.task = context.tasks.spawn(self._attend(activity_task, before))

    async def _attend(self, activity_task: ActivityTask[C, D], before: list[ActivityTask[C, D]]) -> bool:
        """Run it, and do what follows from its end."""
        try:
            danger = await activity_task.run(before)
        finally:
            self._tasks.remove(activity_task)
        announced: Awaitable[None] | None = None

        def announce_and_leave() -> list[asyncio.Future[Verdict]]:
            nonlocal announced
            announced = activity_task.announce_end(danger)
            return self._submit_ended(activity_task)

        if danger is None or activity_task.stopped:  # Stop waits for what this returns, so it must not be waited for
            stands, announced = danger is None, activity_task.announce_end(danger)
        else:
            stands = await self._coordinator.stop(activity_task.act.source, danger, announce_and_leave)
        if announced is not None:
            await announced
        await self._leave(activity_task)
        return stands

    async def _leave(self, activity_task: ActivityTask[C, D]) -> None:
        """Perform its `ended`, unless a Stop has submitted that already; it must lead out of the state."""
        act = activity_task.act
        submitted = [activity_task.left] if activity_task.left is not None else self._submit_ended(activity_task)
        if not submitted:
            return
        await asyncio.wait(submitted)
        if self._current.get(act.branch) is activity_task:
            ended = activity_task.spec.ended
            text = f"{act.branch} is {act.state} without {act.name}: {ended} has not led out of it."
            self._coordinator.fail_for(PcmrsError(text))

    def _submit_ended(self, activity_task: ActivityTask[C, D]) -> list[asyncio.Future[Verdict]]:
        """Submit its `ended` if the branch is still in its state.

        After a motion that leads out of that state, it is denied and leaves no row.
        """
        act = activity_task.act
        if self._closed or self._current.get(act.branch) is not activity_task:
            return []
        activity_task.left = self._coordinator.admit(act.command_to(act.branch, activity_task.spec.ended, {}))
        return [activity_task.left]
