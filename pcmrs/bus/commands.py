"""Commands on the bus: their envelope on ``cmd/<user>/<branch>/<operation>``, and the daemon's edge that takes them.

Commands go to the dispatcher. Stop has its own lane (`pcmrs.bus.stop`).
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Coroutine
from typing import Annotated, Any, ClassVar, Protocol

from msgspec import Meta, field

from pcmrs.background import BackgroundTasks
from pcmrs.bucket import TokenBucket
from pcmrs.bus._session import Bus
from pcmrs.bus.bridge import ARRIVED
from pcmrs.bus.codec import busy, reason_from
from pcmrs.bus.keys import MAX_CHUNK, named_in, split_command_key
from pcmrs.bus.serving import ANSWERS
from pcmrs.bus.stop import Stop, StopLane
from pcmrs.clock import SystemClock
from pcmrs.errors import AccessError, PayloadError, PcmrsError
from pcmrs.messages import Command, Message, Verdict
from pcmrs.messages.clipping import LONGEST_TEXT, clipped_reason, shortened
from pcmrs.messages.identity import Role

_COMMANDS = "cmd/*/*/*"
REPORTED_HZ, REPORTED_AT_ONCE = 10.0, 256
"""Refused puts that are published on ``state/event``: long-term rate, 1/s, and largest burst."""
LONGEST_KEY = 4 * (MAX_CHUNK + 1)
"""Limit of a relative key in the text of a refusal, characters: that of a valid one."""


class Envelope(Message, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A command without its address; every field may be left out.

    Attributes:
        id: Id of the command, unique per user; a repeat runs nothing. The daemon chooses one if it is missing.
        sent: Time of sending, Unix seconds; refused if it lies in the future.
        ttl: Time after `sent` beyond which the command is refused as expired, s; needs `sent`.
        arguments: Arguments of the operation by name.
    """

    max_bytes: ClassVar[int] = 64 * 1024

    id: Annotated[str, Meta(min_length=1, max_length=128)] | None = None
    sent: float | None = None
    ttl: Annotated[float, Meta(ge=0)] | None = None
    arguments: dict[str, Any] = field(default_factory=dict)


class Submit(Protocol):
    """Signature of `Dispatcher.submit`."""

    def __call__(self, command: Command, /, *, arrived: float | None) -> Coroutine[Any, Any, Verdict]:
        """Decide on a command.

        Args:
            command: Command in its envelope, with the role of its user.
            arrived: Arrival time in this process, s of the event loop's clock; None for now.
        """


RefusalCallback = Callable[[str, str, str], None]
"""Called with source, code and text of a message that is not a command."""


class CommandEdge:
    """Server that answers queries on ``cmd/*/*/*`` with their verdicts, and submits puts.

    The verdict on a put is published with the other decisions. This class publishes a refusal on ``state/event`` only
    for a put that is not a command, or that is one too many. In a flood of such puts most are only counted and logged:
    publishing each one would overload the daemon. Use `CommandEdge.open`.
    """

    def __init__(self, bus: Bus, submit: Submit, refused: RefusalCallback, lane: StopLane) -> None:
        self._bus = bus
        self._submit = submit
        self._refused = refused
        self._lane = lane
        self._submitted = BackgroundTasks()
        self._reports = TokenBucket(REPORTED_HZ, REPORTED_AT_ONCE, SystemClock())
        self._ends = (
            bus.serve(_COMMANDS, Envelope, self._answer, refuse=self._refusal),
            bus.subscribe(_COMMANDS, Envelope, self._take, refuse=self._refuse),
        )

    @classmethod
    async def open(cls, bus: Bus, submit: Submit, refused: RefusalCallback, stop: Stop) -> CommandEdge:
        """Start to take commands and Stops; none that is sent after this returns is lost.

        Args:
            bus: Bus of the daemon.
            submit: `Dispatcher.submit`.
            refused: Called in the event loop for each message that is not a command; see `RefusalCallback`.
            stop: Called in the event loop with the source, such as ``bus:local``, and its number of presses; starts the
                Stop before it returns.

        Raises:
            BusError: The second session, for Stop, cannot be opened, or the router delivers nothing to it.
        """
        lane = await StopLane.open(bus.settings, stop)
        try:
            await lane.until_reached(lambda: bus.probe("stop/*"))
        except BaseException:
            await lane.close()
            raise
        return cls(bus, submit, refused, lane)

    async def close(self) -> None:
        """Stop taking commands, cancel the wait for verdicts on puts, and close the lane of Stop."""
        for end in self._ends:
            await end()
        await self._submitted.close()
        await self._lane.close()

    async def _answer(self, key: str, envelope: Envelope) -> Verdict:
        try:
            command = _command_from(key, envelope, self._bus.settings.role_of)
        except (PayloadError, AccessError) as error:
            return self._refusal(key, error)
        return await self._submit(command, arrived=ARRIVED.get())

    def _take(self, key: str, envelope: Envelope) -> None:
        try:
            command = _command_from(key, envelope, self._bus.settings.role_of)
        except (PayloadError, AccessError) as error:
            self._refuse(key, error)
        else:
            if len(self._submitted) < ANSWERS:
                self._submitted.spawn(self._submit(command, arrived=ARRIVED.get()))
            else:
                self._refuse(key, busy(ANSWERS))

    def _refuse(self, key: str, error: PcmrsError) -> None:
        """May run in any thread."""
        if self._reports.take():
            self._bus.publish("state/event", self._refusal(key, error))
        else:
            self._bus.ignore(key, error)

    def _refusal(self, key: str, error: PcmrsError) -> Verdict:
        """May run in any thread: for one message too many, which the bus counts itself."""
        if isinstance(error, (PayloadError, AccessError)):
            text = shortened(f"{shortened(key, LONGEST_KEY)} was refused: {error.text}", LONGEST_TEXT)
            self._refused(f"bus:{shortened(named_in(key), MAX_CHUNK)}", error.code, text)
        return _rejection(key, error)


def _command_from(key: str, envelope: Envelope, role_of: Callable[[str], Role]) -> Command:
    """Return the command in an envelope on a relative key ``cmd/*/*/*``, with the role of its user.

    Raises:
        PayloadError: A part of the key is not a name.
        AccessError: The user may not take part in this cell.
    """
    user, branch, operation = split_command_key(key)
    return Command(
        id=envelope.id or uuid.uuid4().hex,
        branch=branch,
        operation=operation,
        source=f"bus:{user}",
        user=user,
        role=role_of(user),
        arguments=envelope.arguments,
        sent=envelope.sent,
        ttl=envelope.ttl,
    )


def _rejection(key: str, error: PcmrsError) -> Verdict:
    """Return the verdict on a command that never reached the dispatcher: it has no id, state or sequence.

    The sender has chosen the length of the key and of the names in its payload, and the verdict may be published.
    """
    branch, operation = (shortened(part, MAX_CHUNK) for part in key.split("/")[2:])
    return Verdict(
        id="",
        branch=branch,
        operation=operation,
        decision="rejected",
        state="",
        sequence=0,
        reason=clipped_reason(reason_from(error)),
    )
