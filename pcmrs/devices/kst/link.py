"""One TCP connection to a cabinet: commands out, replies in their order, nothing after an answer that never came.

The server has two threads. One answers set points, stops and questions for the joints at once and always; the other
does all the rest, and says ``nak`` or ``interrupted`` unasked when a motion of its breaks off.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import Self, cast

from pcmrs.clock import Clock
from pcmrs.devices.kst.wire import END, LineBuffer
from pcmrs.errors import DeviceError, DeviceRefusedError, MotionInterruptedError, PayloadError, UnknownOutcomeError

REFUSED, INTERRUPTED = "nak", "interrupted"
SILENT = "it did not answer in time"


@dataclass
class _Awaited:
    """A reply to come until a deadline; one that is `sure` comes even when a motion breaks off."""

    reply: asyncio.Future[str]
    deadline: float
    sure: bool


class KstLink(asyncio.Protocol):
    """A connection that works until it fails, and then never again: open another one.

    Args:
        where: The cabinet's address, for messages.
        clock: For deadlines.

    Attributes:
        failure: Why it has failed.
        notice: What it said unasked, until `check` has raised it.
    """

    def __init__(self, where: str, clock: Clock) -> None:
        self._where = where
        self._clock = clock
        self._lines = LineBuffer()
        self._awaited: deque[_Awaited] = deque()
        self._transport: asyncio.Transport | None = None
        self.failure: str | None = None
        self.notice: DeviceError | None = None

    @classmethod
    async def open(cls, host: str, port: int, clock: Clock, timeout: float) -> Self:
        """Connects within `timeout` s.

        Raises:
            DeviceError: Nobody accepts there.
        """
        where = f"{host}:{port}"
        remedy = "start the KST application on the smartPAD (it accepts for 60 s), or set kst.host and kst.port."
        try:
            async with clock.timeout(timeout):
                _, link = await asyncio.get_running_loop().create_connection(lambda: cls(where, clock), host, port)
        except TimeoutError:
            text = f"The cabinet at {where} did not accept within {timeout:g} s; {remedy}"
            raise DeviceError(text, address=where, limit=timeout) from None
        except OSError as error:
            text = f"The cabinet at {where} does not accept ({error.strerror or error}); {remedy}"
            raise DeviceError(text, address=where) from None
        return link

    def send(self, command: str, *timeouts: float, sure: bool = False) -> list[asyncio.Future[str]]:
        """Sends a command at once; never waits.

        Args:
            command: Without its end.
            *timeouts: One for each reply that it has, s from now.
            sure: The reply comes even when a motion breaks off.

        Returns:
            The replies to come; `nak` and `interrupted` become `DeviceRefusedError` and `MotionInterruptedError`.

        Raises:
            UnknownOutcomeError: The link has failed; nothing was sent.
            DeviceError: It has replies, but another one is still outstanding; nothing was sent.
        """
        self.check()
        if timeouts and self._awaited:
            raise DeviceError(f"The cabinet still owes a reply; {command!r} was not sent.", command=command)
        now, loop = self._clock.monotonic(), asyncio.get_running_loop()
        replies = [_Awaited(loop.create_future(), now + timeout, sure) for timeout in timeouts]
        self._awaited.extend(replies)
        if self._transport is not None:
            self._transport.write(command.encode("ascii") + END)
        return [each.reply for each in replies]

    async def ask(self, command: str, *timeouts: float, sure: bool = False) -> list[str]:
        """Sends a command and waits for its replies.

        Raises:
            DeviceRefusedError: `nak`.
            MotionInterruptedError: `interrupted`.
            UnknownOutcomeError: The link has failed, or fails now because a reply does not come in time.
        """
        replies = self.send(command, *timeouts, sure=sure)
        return [await self._before(reply, timeout) for reply, timeout in zip(replies, timeouts, strict=True)]

    async def ask_for_one_or_two(self, command: str, timeout: float, later: float) -> list[str]:
        """Sends a command whose reply may be followed by another one, `later` s after it; see `ask`."""
        first, second = self.send(command, timeout, timeout + later, sure=True)
        lines = [await self._before(first, timeout)]
        await self.drain(later)
        return [*lines, second.result()] if second.done() else lines

    async def drain(self, timeout: float) -> None:
        """Waits for what is outstanding, `timeout` s at most, and for no longer."""
        try:
            async with self._clock.timeout(timeout):
                while self._awaited:
                    await asyncio.wait((self._awaited[0].reply,))
        except TimeoutError:
            self._awaited.clear()

    def check(self) -> None:
        """Fails when a reply is overdue.

        Raises:
            DeviceError: The cabinet has said so unasked.
            UnknownOutcomeError: The link has failed.
        """
        if self.notice is not None:
            notice, self.notice = self.notice, None
            raise notice
        if self._awaited and self._clock.monotonic() > self._awaited[0].deadline:
            self.fail(SILENT)
        if self.failure is not None:
            raise self._unknown(self.failure)

    def fail(self, why: str) -> UnknownOutcomeError:
        """Ends the connection; whatever is awaited, or sent from now on, has an unknown outcome."""
        if self.failure is None:
            self.failure = why
            while self._awaited:
                _settle(self._awaited.popleft().reply, self._unknown(why))
            if self._transport is not None:
                self._transport.abort()
        return self._unknown(self.failure)

    def close(self, farewell: str) -> None:
        """Sends a last command if the link works, and ends the connection."""
        if self.failure is None and self._transport is not None:
            self._transport.write(farewell.encode("ascii") + END)
            self._transport.close()
        self.fail("it was closed")

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)

    def data_received(self, data: bytes) -> None:
        try:
            for line in self._lines.feed(data):
                self._take(line)
        except PayloadError as error:
            self.fail(error.text.rstrip("."))

    def connection_lost(self, error: Exception | None) -> None:
        self.fail("it closed the connection" if error is None else f"the connection broke ({error})")

    async def _before(self, reply: asyncio.Future[str], timeout: float) -> str:
        try:
            async with self._clock.timeout(timeout):
                return await asyncio.shield(reply)  # it is still to come when its caller has been cancelled
        except TimeoutError:
            await asyncio.sleep(0)  # where this process was held up itself, the reply has come and is still to be read
            if reply.done():
                return reply.result()
            raise self.fail(SILENT) from None

    def _unknown(self, why: str) -> UnknownOutcomeError:
        text = f"The link to the cabinet at {self._where} is lost: {why}. Look at the arm, then connect again."
        return UnknownOutcomeError(text, address=self._where)

    def _take(self, line: str) -> None:
        if self.failure is not None:
            return
        failed = line in (REFUSED, INTERRUPTED)
        if failed and (not self._awaited or self._awaited[0].sure):
            self.notice = _failure(line)
            return
        if not self._awaited:
            raise PayloadError(f"It sent {line[:40]!r} unasked.", line=line[:40])
        reply = self._awaited.popleft().reply
        if failed:
            self._awaited.clear()  # nothing follows
            _settle(reply, _failure(line))
        elif not reply.done():
            reply.set_result(line)


def _failure(line: str) -> DeviceError:
    if line == REFUSED:
        return DeviceRefusedError("The cabinet refused (nak). Look at the smartPAD: mode, brakes, protective stop.")
    return MotionInterruptedError("The cabinet interrupted the motion. Look at the arm before going on.")


def _settle(reply: asyncio.Future[str], error: Exception) -> None:
    if not reply.done():  # its caller was cancelled
        reply.set_exception(error)
        reply.exception()  # who looks at it later finds it; who does not has been told in another way
