"""Stop: from the press, or a danger event, to the confirmed standstill; numbers of Stops, and presses that join one.

Until the hold of a Stop is answered, nothing can release the latch, and a further press would change nothing. Such
presses are counted: endless pressing must neither delay the loop nor fill the journal.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Any, Final, Generic

from pcmrs.clock import Clock
from pcmrs.dispatcher._activities import Activities
from pcmrs.dispatcher.decisions import Decisions
from pcmrs.dispatcher.events import DAEMON, Coordinator, QueuedRow, Submission, not_confirmed, pressed_again, stopped
from pcmrs.dispatcher.execution import ExecutionContext
from pcmrs.dispatcher.procedure import NO_STOP
from pcmrs.dispatcher.workflow import C, D
from pcmrs.messages import STOP_NOT_NAMED, Command, Reason, StopState, Verdict
from pcmrs.messages.identity import LOCAL

YOUNG = 1.0
"""Age below which a Stop is acknowledged by its number only, s: a user who does not name it may not know of it yet."""

NUMBERS = 1_000_000
"""Size of the range of numbers for the Stops of one run, so that no number occurs twice across restarts."""

STANDSTILL = "standstill"
"""Name under which an acknowledgement waits for a hold."""

PENDING = "stop_pending"
"""Code of the refusal of an acknowledgement that must wait."""


class Stops:
    """Number Stops, and know what an acknowledgement waits for.

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

    def confirm(self, number: int) -> None:
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


class StopControl(Generic[C, D]):
    """Stop everything, and follow each Stop until the robot has confirmed that it stands.

    Args:
        context: Shared parts of the dispatcher.
        stops: Numbers Stops and knows what each waits for.
        decisions: Rejects waiting commands.
        activities: Activities that may move the robot.

    Attributes:
        in_doubt: The hold of a Stop or a failure was not confirmed, and this has not been acknowledged since.
    """

    def __init__(
        self,
        context: ExecutionContext[C, D],
        stops: Stops,
        decisions: Decisions[C, D],
        activities: Activities[C, D],
    ) -> None:
        self.in_doubt = False
        self._coordinator = context.coordinator
        self._procedure = context.procedure
        self._tasks = context.tasks
        self._hold = context.hold
        self._presses = Presses(context.coordinator)
        self._stops = stops
        self._locks = context.locks
        self._decisions = decisions
        self._activities = activities
        self._listeners = context.listeners

    def begin(self, source: str, reason: Reason | None, then: Submission) -> asyncio.Task[bool]:
        """Begin to stop everything; see `Dispatcher.begin_stop`.

        Args:
            source: Who stops.
            reason: Why; by default that `source` has requested it.
            then: Submits the operations that follow from a danger event.
        """
        reason = reason or Reason(code="stopped", text=f"Stopped by {source}.", fields={"source": source})
        number, holding = self.latch(), self._hold.stop()
        self._stops.wait_for(STANDSTILL, holding)
        moving = self._activities.end_moving()
        ending = [pending.verdict for pending in self._locks.running]
        for pending in self._locks.running:
            pending.stop(reason)
        self._listeners.notify_stop()
        for pending in self._locks.drain_commands():
            pending.end_wait()
            self._decisions.reject(pending.command, pending.verdict, reason)
        recorded = self._coordinator.announce(stopped(source, reason, number))
        following = self.follow_danger(then)
        self._coordinator.publish_snapshot()
        return self._tasks.spawn(self._end(number, source, recorded, [holding, *ending, *moving, *following]))

    def press(self, source: str, presses: int) -> StopUnderWay:
        """Stop for a person; see `Dispatcher.press_stop`.

        Args:
            source: Who stops.
            presses: Number of presses of this source since the last call.
        """
        stop = self._presses.find(source)
        if stop is None or self._started_since_stop():
            standing = self.begin(source, None, list)
            stop, presses = StopUnderWay(source, self._stops.state.number, standing), presses - 1
            self._presses.add(stop, self._hold.stop())
        else:
            self._listeners.notify_stop()  # commands that have come to the edges since end, too
        if presses:
            stop.join(source, presses)
        return stop

    def latch(self) -> int:
        """Set the latch, which counts as a Stop; return the Stop's number."""
        self._stops.begin()
        self._procedure.latch()
        return self._stops.state.number

    def follow_danger(self, submit: Submission) -> list[asyncio.Future[Verdict]]:
        """Submit the operations that follow from danger, and allow no acknowledgement before they are decided.

        Operations that the state does not allow are decided already: they neither run nor wait.
        """
        following = submit()
        for pending in (*self._locks.running, *self._locks.waiting):
            if pending.verdict in following:
                self._stops.wait_for(pending.name, pending.verdict)
        return following

    async def hold_after_failure(self, number: int) -> None:
        """Hold the robot because of a failure, and confirm Stop `number` or doubt that the robot stands."""
        await self.take_standstill(number, DAEMON, stands=await self._hold.stop())

    async def take_standstill(self, number: int, source: str, *, stands: bool) -> None:
        """Confirm a Stop, or announce that robot or stimulator have not confirmed that they stand.

        Args:
            number: Number of the Stop.
            source: Who has stopped.
            stands: Robot and stimulator have confirmed.
        """
        if stands:
            self._stops.confirm(number)
            self._coordinator.publish_snapshot()
        else:
            self.in_doubt = True
            await self._coordinator.announce(not_confirmed(source))

    def _started_since_stop(self) -> bool:
        """Return whether anything runs or waits that the last Stop has not ended."""
        running = any(pending.stopped is None for pending in self._locks.running)
        return running or any(not pending.spec.event for pending in self._locks.waiting)

    async def _end(self, number: int, source: str, recorded: QueuedRow, ending: list[asyncio.Future[Any]]) -> bool:
        await recorded
        await asyncio.wait(ending)
        confirmed = all(each.result() is not False for each in ending)
        await self.take_standstill(number, source, stands=confirmed)
        return confirmed
