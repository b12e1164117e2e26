"""The daemon's edge on the bus: commands to the dispatcher, Stop past everything."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any, Protocol

from pcmrs.background import BackgroundTasks
from pcmrs.bucket import TokenBucket
from pcmrs.bus.bridge import ARRIVED
from pcmrs.bus.codec import busy
from pcmrs.bus.envelope import Envelope, command_from, refusal
from pcmrs.bus.keys import named_in
from pcmrs.bus.serving import ANSWERS
from pcmrs.bus.session import Bus
from pcmrs.bus.stop import Stop, StopLane
from pcmrs.clock import SystemClock
from pcmrs.errors import AccessError, PayloadError, PcmrsError
from pcmrs.messages import Command, Verdict

_COMMANDS = "cmd/*/*/*"
TOLD_HZ, TOLD_AT_ONCE = 10.0, 256
"""Refused puts that are told on ``state/event``: so many per second in the long run, and so many at once."""


class Submit(Protocol):
    """`Dispatcher.submit`."""

    def __call__(self, command: Command, /, *, arrived: float) -> Coroutine[Any, Any, Verdict]:
        """Decide on a command.

        Args:
            command: As it was sent.
            arrived: When it arrived in this process, s of the event loop's clock.
        """


Refused = Callable[[str, str, str], None]


class CommandEdge:
    """Answers queries on ``cmd/*/*/*`` with their verdicts and submits what is put there.

    The verdict on a put is for whoever publishes decisions; only a put that is no command at all, or one
    too many, is refused on ``state/event`` from here. Of very many such puts most are only counted and logged: telling
    everybody of each would keep the daemon from its work. Use `CommandEdge.open`.
    """

    def __init__(self, bus: Bus, submit: Submit, refused: Refused, lane: StopLane) -> None:
        self._bus = bus
        self._submit = submit
        self._refused = refused
        self._lane = lane
        self._submitted = BackgroundTasks()
        self._told = TokenBucket(TOLD_HZ, TOLD_AT_ONCE, SystemClock())
        self._ends = (
            bus.serve(_COMMANDS, Envelope, self._answer, refuse=self._refusal),
            bus.subscribe(_COMMANDS, Envelope, self._take, refuse=self._refuse),
        )

    @classmethod
    async def open(cls, bus: Bus, submit: Submit, refused: Refused, stop: Stop) -> CommandEdge:
        """Starts taking commands and Stops; none that is sent after it returns is lost.

        Args:
            bus: The daemon's bus.
            submit: `Dispatcher.submit`.
            refused: Called in the event loop with source, code and text of what is no command.
            stop: Called in the event loop with the source, such as ``bus:local``, and how often it has pressed; begins
                to stop before it returns.

        Raises:
            BusError: The second session, for Stop, cannot be opened, or the router brings nothing to it.
        """
        lane = await StopLane.open(bus.settings, stop)
        try:
            await lane.until_reached(lambda: bus.look_around("stop/*"))
        except BaseException:
            await lane.close()
            raise
        return cls(bus, submit, refused, lane)

    async def close(self) -> None:
        """Takes no more commands, gives up waiting for the verdicts on puts, and closes the lane of Stop."""
        for end in self._ends:
            await end()
        await self._submitted.close()
        await self._lane.close()

    async def _answer(self, key: str, envelope: Envelope) -> Verdict:
        try:
            command = command_from(key, envelope, self._bus.settings.role_of)
        except (PayloadError, AccessError) as error:
            return self._refusal(key, error)
        return await self._submit(command, arrived=ARRIVED.get())

    def _take(self, key: str, envelope: Envelope) -> None:
        try:
            command = command_from(key, envelope, self._bus.settings.role_of)
        except (PayloadError, AccessError) as error:
            self._refuse(key, error)
        else:
            if len(self._submitted) < ANSWERS:
                self._submitted.spawn(self._submit(command, arrived=ARRIVED.get()))
            else:
                self._refuse(key, busy(ANSWERS))

    def _refuse(self, key: str, error: PcmrsError) -> None:
        """May run in any thread."""
        if self._told.take():
            self._bus.publish("state/event", self._refusal(key, error))
        else:
            self._bus.ignore(key, error)

    def _refusal(self, key: str, error: PcmrsError) -> Verdict:
        """May run in any thread for one message too many, of which the bus keeps count."""
        if isinstance(error, (PayloadError, AccessError)):
            self._refused(f"bus:{named_in(key)}", error.code, f"{key} was refused: {error.text}")
        return refusal(key, error)
