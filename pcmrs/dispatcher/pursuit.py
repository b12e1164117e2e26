"""One activity: from the commit that entered its state until it does nothing any more."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from typing import Any, Generic

import structlog

from pcmrs.dispatcher.activity import Activity
from pcmrs.dispatcher.events import ACTIVITY_ENDED, ACTIVITY_STARTED, NOT_CONFIRMED
from pcmrs.dispatcher.perform import reason_of
from pcmrs.dispatcher.run import C, D
from pcmrs.dispatcher.stage import Stage, performing
from pcmrs.errors import PcmrsError
from pcmrs.fsm.blueprint import ActivitySpec
from pcmrs.messages import DeviceEvent, Reason, Verdict

log = structlog.get_logger(__name__)


class Pursuit(Generic[C, D]):
    """Runs the function of an activity until it ends, or is told to.

    Args:
        stage: What it is performed with.
        spec: How it is declared.
        act: What its function sees.
        tell: Makes an event known and durable.

    Attributes:
        task: Attends to it; the result is whether the robot stands, or a motion moves it.
        ending: It has been told to end, or not to begin.
        relieved: A motion takes over from it.
        left: The verdict on its `ended`, once that is submitted.
        quiet: It does nothing any more, and where it moved the robot and no motion takes over, that has been held.
    """

    def __init__(
        self,
        stage: Stage[C, D],
        spec: ActivitySpec,
        act: Activity[C, D],
        tell: Callable[[DeviceEvent], Awaitable[None]],
    ) -> None:
        self.spec = spec
        self.act = act
        self.task: asyncio.Task[bool] | None = None
        self.ending = spec.moves and stage.procedure.latched
        self.relieved = False
        self.left: asyncio.Future[Verdict] | None = None
        self.quiet = asyncio.Event()
        self._stage = stage
        self._tell = tell
        self._function: asyncio.Task[Exception | None] | None = None
        self._begun = False

    @property
    def goes_on(self) -> bool:
        """Whether it runs or is about to."""
        return not self.ending and not self.quiet.is_set()

    @property
    def stopped(self) -> bool:
        """Whether Stop has ended it, or kept it from beginning."""
        return self.ending and self._stage.procedure.latched

    def end(self) -> None:
        """Cancels its function, once: a second time would break off how it ends its motion."""
        if self._function is not None and not self.ending:
            self._function.cancel()
        self.ending = True

    async def run(self, before: Iterable[Pursuit[C, D]]) -> Reason | None:
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
        return self._tell(self._event(ACTIVITY_ENDED, f"{self.act.name} has ended: {how}"))

    async def _perform(self) -> Reason | None:
        """Performs its function as soon as its beginning is durable."""
        act = self.act
        self._begun = True
        await self._tell(self._event(ACTIVITY_STARTED, f"{act.name} begins: {act.branch} is {act.state}."))
        if self.ending:
            return None
        self._function = self._stage.tasks.spawn(self._within())
        await asyncio.wait([self._function])
        return self._danger(self._function)

    async def _within(self) -> Exception | None:
        performing.set(id(self._stage.procedure))
        try:
            await self._stage.workflow.registry.activities[self.act.name](self.act)
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
        if await self._stage.hold.end_motion():
            return None
        text = f"The robot has not confirmed that it stands after {self.act.name}: look at it."
        return Reason(code=NOT_CONFIRMED, text=text)

    def _event(self, code: str, text: str) -> DeviceEvent:
        act = self.act
        fields: dict[str, Any] = {"branch": act.branch, "state": act.state, "command": act.command.id}
        return DeviceEvent(device=act.source, code=code, text=text, fields=fields)
