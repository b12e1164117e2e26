"""Activities: begun with the commit that enters their state, ended with the one that leaves it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterable
from typing import Any, Generic

import structlog

from pcmrs.dispatcher.events import ACTIVITY_ENDED, ACTIVITY_STARTED, NOT_CONFIRMED
from pcmrs.dispatcher.execution import ExecutionContext, performing, reason_of
from pcmrs.dispatcher.run import Activity, C, D
from pcmrs.errors import PcmrsError
from pcmrs.fsm.blueprint import ActivitySpec
from pcmrs.messages import ActiveActivity, Command, DeviceEvent, Reason, Verdict

log = structlog.get_logger(__name__)


class ActivityTask(Generic[C, D]):
    """Runs the function of an activity until it ends, or is told to.

    Args:
        context: What it is performed with.
        spec: How it is declared.
        act: What its function sees.

    Attributes:
        task: Attends to it; the result is whether the robot stands, or a motion moves it.
        ending: It has been told to end, or not to begin.
        relieved: A motion takes over from it.
        left: The verdict on its `ended`, once that is submitted.
        quiet: It does nothing any more, and where it moved the robot and no motion takes over, that has been held.
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
        self._begun = False

    @property
    def goes_on(self) -> bool:
        """Whether it runs or is about to."""
        return not self.ending and not self.quiet.is_set()

    @property
    def stopped(self) -> bool:
        """Whether Stop has ended it, or kept it from beginning."""
        return self.ending and self._context.procedure.latched

    def end(self) -> None:
        """Cancels its function, once: a second time would break off how it ends its motion."""
        if self._function is not None and not self.ending:
            self._function.cancel()
        self.ending = True

    async def run(self, before: Iterable[ActivityTask[C, D]]) -> Reason | None:
        """Runs it once those before it are quiet: why its end is dangerous, if it is."""
        try:
            for earlier in before:
                await earlier.quiet.wait()
            danger = None if self.ending else await self._perform()
            if danger is None and self.spec.moves and not self.relieved:
                danger = await self._held()
            return danger
        finally:
            self.quiet.set()

    def tell_end(self, danger: Reason | None) -> Awaitable[None] | None:
        """Makes known at once that it has ended, if it had begun; returns what ends when that is durable."""
        if not self._begun:
            return None
        how = danger.text if danger is not None else "as it was told to."
        return self._coordinator.announce(self._event(ACTIVITY_ENDED, f"{self.act.name} has ended: {how}"))

    async def _perform(self) -> Reason | None:
        """Performs its function as soon as its beginning is durable."""
        act = self.act
        self._begun = True
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
        """Why the end of the function is dangerous: it was not told to end, or did not end well."""
        act = self.act
        error = None if function.cancelled() else function.result()
        if error is not None and not isinstance(error, PcmrsError):
            log.error("activity_raised", activity=act.name, exc_info=error)
        if self.stopped or (error is None and self.ending):
            return None  # at Stop it may have failed because of the hold, before it was cancelled
        if isinstance(error, PcmrsError):
            return reason_of(error, activity=act.name)
        code, how = ("activity_raised", "raised an error; the log has it") if error else ("activity_ended", "ended")
        text = f"{act.name} has {how} by itself while {act.branch} was {act.state}."
        return Reason(code=code, text=text, fields={"activity": act.name})

    async def _held(self) -> Reason | None:
        """Holds the robot after it was moved: why that is dangerous, if it is."""
        if await self._context.hold.end_motion():
            return None
        text = f"The robot has not confirmed that it stands after {self.act.name}: look at it."
        return Reason(code=NOT_CONFIRMED, text=text)

    def _event(self, code: str, text: str) -> DeviceEvent:
        act = self.act
        fields: dict[str, Any] = {"branch": act.branch, "state": act.state, "command": act.command.id}
        return DeviceEvent(device=act.source, code=code, text=text, fields=fields)


class Activities(Generic[C, D]):
    """The activities of the states that the branches are in.

    One that ends by itself is danger: it takes the lane of Stop, then its `ended` is performed. One that moves the
    robot gives way to a motion, ends with Stop, and is followed by a hold in all other cases.

    Args:
        context: What they are performed with.
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
        """What the snapshot shows of them."""
        acts = (each.act for each in self._current.values() if each.goes_on)
        return [ActiveActivity(branch=act.branch, state=act.state, name=act.name, values=act.values) for act in acts]

    def follow(self, command: Command) -> None:
        """Ends the activities of states that have been left, and begins those of states that `command` has entered."""
        joint = self._context.procedure.joint() if self._declared else {}
        for branch, declared in self._declared.items():
            state, current = joint[branch], self._current.get(branch)
            if current is not None and current.act.state != state:
                del self._current[branch]
                current.end()
            if state in declared and branch not in self._current and not self._closed:
                self._begin(declared[state], branch, state, command)

    async def give_way(self) -> None:
        """A motion takes over: returns when nothing else moves the robot any more."""
        moving = [each for each in self._tasks if each.spec.moves]
        for each in moving:
            each.relieved = True
            each.end()
        for each in moving:
            await each.quiet.wait()

    @property
    def moving(self) -> bool:
        """Whether one that moves the robot goes on."""
        return any(each.spec.moves and not each.quiet.is_set() for each in self._tasks)

    def end_moving(self) -> list[asyncio.Task[bool]]:
        """Ends those that move the robot, as Stop does; returns what is to be waited for: see `ActivityTask.task`."""
        moving = [each for each in self._tasks if each.spec.moves and not each.quiet.is_set()]
        for each in moving:
            each.end()
        return [each.task for each in moving if each.task is not None]

    def close(self) -> None:
        """Ends all; none begins any more, and no command follows."""
        self._closed = True
        for each in self._tasks:
            each.end()

    def open(self) -> None:
        """After `close`: activities may begin again."""
        self._closed = False

    async def leave_ended(self) -> None:
        """Performs the `ended` of those that `close` has ended in a state that its branch is still in."""
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
        """Runs it and does what its end demands."""
        try:
            danger = await activity_task.run(before)
        finally:
            self._tasks.remove(activity_task)
        told: Awaitable[None] | None = None

        def tell_and_leave() -> list[asyncio.Future[Verdict]]:
            nonlocal told
            told = activity_task.tell_end(danger)
            return self._submit_ended(activity_task)

        if danger is None or activity_task.stopped:  # Stop waits for what this returns, so it must not be waited for
            stands, told = danger is None, activity_task.tell_end(danger)
        else:
            stands = await self._coordinator.stop(activity_task.act.source, danger, tell_and_leave)
        if told is not None:
            await told
        await self._leave(activity_task)
        return stands

    async def _leave(self, activity_task: ActivityTask[C, D]) -> None:
        """Performs its `ended`, which a Stop because of it has submitted already; that has to lead out of the state."""
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
        """Submits its `ended` where the branch is still in its state.

        Behind a motion that leads out of that state, it is denied without a trace.
        """
        act = activity_task.act
        if self._closed or self._current.get(act.branch) is not activity_task:
            return []
        activity_task.left = self._coordinator.admit(act.command_to(act.branch, activity_task.spec.ended, {}))
        return [activity_task.left]
