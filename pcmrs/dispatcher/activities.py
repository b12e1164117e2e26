"""Begins activities with the commit that enters their state, and ends them with the one that leaves it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Generic

from pcmrs.dispatcher.activity import Activity
from pcmrs.dispatcher.pursuit import Pursuit
from pcmrs.dispatcher.run import C, D
from pcmrs.dispatcher.stage import Stage
from pcmrs.errors import PcmrsError
from pcmrs.fsm.blueprint import ActivitySpec
from pcmrs.messages import Command, DeviceEvent, Ongoing, Reason, Verdict


class Activities(Generic[C, D]):
    """The activities of the states that the branches are in.

    One that ends by itself is danger: it takes the lane of Stop, then its `ended` is performed. One that moves the
    robot gives way to a motion, ends with Stop, and is followed by a hold in all other cases.

    Args:
        stage: What they are performed with.
        submit: Decides on a command.
        stop: Stops everything, and submits what follows at once; returns whether the robot has confirmed that it
            stands.
        tell: Makes an event known and durable.
        broken: Ends the dispatcher for safety.
    """

    def __init__(
        self,
        stage: Stage[C, D],
        submit: Callable[[Command], asyncio.Future[Verdict]],
        stop: Callable[[str, Reason, Callable[[], list[asyncio.Future[Verdict]]]], Awaitable[bool]],
        tell: Callable[[DeviceEvent], Awaitable[None]],
        broken: Callable[[BaseException], Reason],
    ) -> None:
        self._stage = stage
        self._submit = submit
        self._stop = stop
        self._tell = tell
        self._broken = broken
        branches = stage.workflow.blueprint.branches
        self._declared = {name: branch.activities for name, branch in branches.items() if branch.activities}
        self._current: dict[str, Pursuit[C, D]] = {}
        self._pursuits: list[Pursuit[C, D]] = []
        self._closed = False

    def shown(self) -> list[Ongoing]:
        """What the snapshot shows of them."""
        acts = (each.act for each in self._current.values() if each.goes_on)
        return [Ongoing(branch=act.branch, state=act.state, name=act.name, values=act.values) for act in acts]

    def follow(self, command: Command) -> None:
        """Ends the activities of states that have been left, and begins those of states that `command` has entered."""
        joint = self._stage.procedure.joint() if self._declared else {}
        for branch, declared in self._declared.items():
            state, current = joint[branch], self._current.get(branch)
            if current is not None and current.act.state != state:
                del self._current[branch]
                current.end()
            if state in declared and branch not in self._current and not self._closed:
                self._begin(declared[state], branch, state, command)

    async def give_way(self) -> None:
        """A motion takes over: returns when nothing else moves the robot any more."""
        moving = [each for each in self._pursuits if each.spec.moves]
        for each in moving:
            each.relieved = True
            each.end()
        for each in moving:
            await each.quiet.wait()

    @property
    def moving(self) -> bool:
        """Whether one that moves the robot goes on."""
        return any(each.spec.moves and not each.quiet.is_set() for each in self._pursuits)

    def end_moving(self) -> list[asyncio.Task[bool]]:
        """Ends those that move the robot, as Stop does; returns what is to be waited for: see `Pursuit.task`."""
        moving = [each for each in self._pursuits if each.spec.moves and not each.quiet.is_set()]
        for each in moving:
            each.end()
        return [each.task for each in moving if each.task is not None]

    def close(self) -> None:
        """Ends all; none begins any more, and no command follows."""
        self._closed = True
        for each in self._pursuits:
            each.end()

    def open(self) -> None:
        """After `close`: activities may begin again."""
        self._closed = False

    async def leave_ended(self) -> None:
        """Performs the `ended` of those that `close` has ended in a state that its branch is still in."""
        for each in [each for each in self._current.values() if each.quiet.is_set()]:
            await self._leave(each)

    def _begin(self, spec: ActivitySpec, branch: str, state: str, command: Command) -> None:
        stage, procedure = self._stage, self._stage.procedure
        act = Activity(
            name=spec.run,
            branch=branch,
            state=state,
            command=command,
            cell=stage.cell,
            clock=stage.clock,
            _data=lambda: procedure.data,
            _states=procedure.joint,
            _submit=self._submit,
            _show=stage.show,
        )
        before = [each for each in self._pursuits if each.act.branch == branch]
        pursuit = Pursuit(stage, spec, act, self._tell)
        self._current[branch] = pursuit
        self._pursuits.append(pursuit)
        pursuit.task = stage.tasks.spawn(self._attend(pursuit, before))

    async def _attend(self, pursuit: Pursuit[C, D], before: list[Pursuit[C, D]]) -> bool:
        """Runs it and does what its end demands."""
        try:
            danger = await pursuit.run(before)
        finally:
            self._pursuits.remove(pursuit)
        told: Awaitable[None] | None = None

        def tell_and_leave() -> list[asyncio.Future[Verdict]]:
            nonlocal told
            told = pursuit.tell_end(danger)
            return self._submit_ended(pursuit)

        if danger is None or pursuit.stopped:  # Stop waits for what this returns, so it must not be waited for
            stands, told = danger is None, pursuit.tell_end(danger)
        else:
            stands = await self._stop(pursuit.act.source, danger, tell_and_leave)
        if told is not None:
            await told
        await self._leave(pursuit)
        return stands

    async def _leave(self, pursuit: Pursuit[C, D]) -> None:
        """Performs its `ended`, which a Stop because of it has submitted already; that has to lead out of the state."""
        act = pursuit.act
        submitted = [pursuit.left] if pursuit.left is not None else self._submit_ended(pursuit)
        if not submitted:
            return
        await asyncio.wait(submitted)
        if self._current.get(act.branch) is pursuit:
            ended = pursuit.spec.ended
            self._broken(PcmrsError(f"{act.branch} is {act.state} without {act.name}: {ended} has not led out of it."))

    def _submit_ended(self, pursuit: Pursuit[C, D]) -> list[asyncio.Future[Verdict]]:
        """Submits its `ended` where the branch is still in its state.

        Behind a motion that leads out of that state, it is denied without a trace.
        """
        act = pursuit.act
        if self._closed or self._current.get(act.branch) is not pursuit:
            return []
        pursuit.left = self._submit(act.command_to(act.branch, pursuit.spec.ended, {}))
        return [pursuit.left]
