"""Stop: the numbers of Stops, presses that meet a pending Stop, and how the robot is held.

Until the hold of a Stop is answered, nothing can release the latch, and a further press would change nothing. Such
presses are counted: endless pressing must neither delay the loop nor fill the journal.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any, Final

import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.dispatcher._coordinator import Coordinator
from pcmrs.dispatcher.events import pressed_again
from pcmrs.messages import STOP_NOT_NAMED, Command, Reason, StopState
from pcmrs.messages.identity import LOCAL

YOUNG = 1.0
"""Age below which a Stop is acknowledged by its number only, s: a user who does not name it may not know of it yet."""

NUMBERS = 1_000_000
"""Size of the range of numbers for the Stops of one run, so that no number occurs twice across restarts."""

STANDSTILL = "standstill"
"""Name under which an acknowledgement waits for a hold."""

PENDING = "stop_pending"
"""Code of the refusal of an acknowledgement that must wait."""

NO_STOP = StopState()


class Stops:
    """Numbers Stops, and knows what an acknowledgement waits for.

    Args:
        clock: The cell's clock.

    Attributes:
        state: State of the newest Stop; number 0 before the first one.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._since = 0.0
        self.state = NO_STOP
        self._pending: dict[asyncio.Future[Any], str] = {}
        self._first = 0

    def number_from(self, start: int) -> None:
        """Give the Stops of this run numbers greater than those of all earlier runs.

        Args:
            start: Number that grows with each run: sequence of the journal's row of this start.
        """
        self._first = start * NUMBERS

    def begin(self) -> None:
        """Begin a Stop: it has its number before anything is awaited."""
        number = max(self.state.number, self._first) + 1
        self._since = self._clock.monotonic()
        self.state = StopState(number=number, pending=self._waits_for(), confirmed=False)

    def stood(self, number: int) -> None:
        """Confirm that standstill was measured after the hold of Stop `number`."""
        if number == self.state.number:
            self.state = StopState(number=number, pending=self.state.pending, confirmed=True)

    def wait_for(self, what: str, end: asyncio.Future[Any]) -> None:
        """Refuse acknowledgements until a future is done.

        Args:
            what: Name that a refusal gives.
            end: The future.
        """
        if end not in self._pending:  # Stops that follow each other quickly wait for the same hold
            end.add_done_callback(self._settle)
        self._pending[end] = what
        self._show()

    @property
    def standing(self) -> bool:
        """True if no hold is pending."""
        return STANDSTILL not in self._pending.values()

    def objection(self, command: Command, *, latched: bool) -> Reason | None:
        """Return why a command may not acknowledge now; None if it may.

        Args:
            command: The acknowledgement.
            latched: Stop is latched.
        """
        named, state = command.arguments.get("stop"), self.state
        if named is not None and named != state.number:
            text = f"Stop {named} is not the newest one, which is Stop {state.number}: find out why it was pressed, "
            text += "then acknowledge that one."
            return Reason(code="stop_outdated", text=text, fields={"stop": named, "newest": state.number})
        if self._pending:
            text = (
                f"Stop {state.number} cannot be acknowledged yet; it waits for: {', '.join(state.pending)}. Ask again."
            )
            return Reason(code=PENDING, text=text, fields={"stop": state.number, "pending": state.pending})
        if named is not None or not latched:
            return None
        if command.user != LOCAL:
            text = f"Name the Stop that you acknowledge: stop = {state.number}, the newest one."
            return Reason(code=STOP_NOT_NAMED, text=text, fields={"newest": state.number})
        age = self._clock.monotonic() - self._since
        if age < YOUNG:
            text = f"Stop {state.number} is only {age:.1f} s old, limit {YOUNG:g} s: name it (stop = {state.number}), "
            text += "or look, and ask again."
            return Reason(code=STOP_NOT_NAMED, text=text, fields={"newest": state.number, "age": age})
        return None

    def _settle(self, end: asyncio.Future[Any]) -> None:
        self._pending.pop(end, None)  # two Stops may share one hold
        self._show()

    def _show(self) -> None:
        state = self.state
        self.state = StopState(number=state.number, pending=self._waits_for(), confirmed=state.confirmed)

    def _waits_for(self) -> list[str]:
        return sorted(set(self._pending.values()))


SOURCES: Final = 32
"""Limit of sources of one kind, such as all of the bus, with their own pending Stop. One more joins the newest Stop,
which counts it by name."""
NAMED: Final = 32
"""Limit of names that one Stop counts; further ones are counted together."""
OTHERS: Final = "others"


@dataclass(eq=False, slots=True)
class StopUnderWay:
    """One Stop.

    Attributes:
        source: Who has stopped.
        number: Number of the Stop.
        standing: Task whose result is whether the robot has confirmed that it stands.
        joined: Source to number of its presses that have joined this Stop.
    """

    source: str
    number: int
    standing: asyncio.Task[bool]
    joined: dict[str, int] = field(default_factory=dict)

    def join(self, source: str, presses: int) -> None:
        """Count presses that join this Stop.

        Args:
            source: Who has pressed.
            presses: Number of presses.
        """
        name = source if source in self.joined or len(self.joined) < NAMED else OTHERS
        self.joined[name] = self.joined.get(name, 0) + presses


class Presses:
    """Pending Stops, by source.

    Args:
        coordinator: The dispatcher, which announces a Stop that others have joined once it is no longer pending.
    """

    def __init__(self, coordinator: Coordinator[Any, Any]) -> None:
        self._coordinator = coordinator
        self._under_way: dict[str, StopUnderWay] = {}

    def find(self, source: str) -> StopUnderWay | None:
        """Return the pending Stop that a press by `source` joins; None if it begins one."""
        own = self._under_way.get(source)
        if own is None and sum(_kind(each) == _kind(source) for each in self._under_way) >= SOURCES:
            return next(reversed(self._under_way.values()))
        return own

    def add(self, stop: StopUnderWay, holding: asyncio.Future[bool]) -> None:
        """Add a Stop that has begun.

        Args:
            stop: The Stop.
            holding: Its hold. The Stop is pending until this is done.
        """
        self._under_way.pop(stop.source, None)  # the newest comes last
        self._under_way[stop.source] = stop
        holding.add_done_callback(lambda _: self._end(stop))

    def _end(self, stop: StopUnderWay) -> None:
        if self._under_way.get(stop.source) is stop:
            del self._under_way[stop.source]
        if stop.joined:
            self._coordinator.announce_later(pressed_again(stop.source, stop.number, stop.joined))


def _kind(source: str) -> str:
    """Kind of a source, such as ``bus`` or ``udp``: sources of one kind take no places of others."""
    return source.partition(":")[0]


log = structlog.get_logger(__name__)


class Hold:
    """Makes the devices stand still, and knows whether that was confirmed.

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
