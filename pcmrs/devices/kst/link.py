"""One TCP connection to a cabinet: commands, and their replies in order; a missing reply ends the connection.

The server has two threads. One always answers set points, stops and requests for the joints at once. The other does all
the rest, and sends ``nak`` or ``interrupted`` by itself if one of its motions breaks off.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import Self, cast

from pcmrs.clock import Clock
from pcmrs.devices.kst.wire import END, LineBuffer
from pcmrs.errors import DeviceError, DeviceRefusedError, MotionInterruptedError, PayloadError, UnknownOutcomeError

DONE = "done"
"""Acknowledgement of a command that has no result."""
REFUSED, INTERRUPTED = "nak", "interrupted"
"""Replies to a command that the cabinet refuses, and to a motion that it breaks off."""
SILENT = "it did not answer in time"


@dataclass
class _Awaited:
    """An outstanding reply.

    Attributes:
        reply: Future of the reply.
        deadline: Time until which it must arrive, s of the clock.
        sure: True if it arrives even if a motion breaks off.
    """

    reply: asyncio.Future[str]
    deadline: float
    sure: bool


class KstLink(asyncio.Protocol):
    """A connection that works until it fails, and then never again: open another one.

    Args:
        where: Address of the cabinet, for messages.
        clock: Clock for deadlines.

    Attributes:
        failure: Reason why it has failed; None while it works.
        notice: Error that the cabinet reported by itself, until `check` has raised it.
    """

    def __init__(self, where: str, clock: Clock) -> None:
        self._where = where
        self._clock = clock
        self._lines = LineBuffer()
        self._awaited: deque[_Awaited] = deque()
        self._ending: _Awaited | None = None  # reply at the end of a motion, which arrives between other replies
        self._transport: asyncio.Transport | None = None
        self.failure: str | None = None
        self.notice: DeviceError | None = None

    @classmethod
    async def open(cls, host: str, port: int, clock: Clock, timeout: float) -> Self:
        """Connect.

        Args:
            host: Host name or address of the cabinet.
            port: TCP port of the KST application.
            clock: Clock for deadlines.
            timeout: Longest wait for the connection, s.

        Raises:
            DeviceError: The connection is refused or takes too long.
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
        """Send a command at once; never waits.

        Args:
            command: Command without its line end.
            *timeouts: One for each reply of the command, s from now.
            sure: True if the reply arrives even if a motion breaks off.

        Returns:
            Futures of the replies; `nak` and `interrupted` become `DeviceRefusedError` and `MotionInterruptedError`.

        Raises:
            UnknownOutcomeError: The link has failed; nothing was sent.
            DeviceError: The command has replies, but another reply is still outstanding; nothing was sent.
        """
        self.check()
        if timeouts and self._awaited:
            raise DeviceError(f"A reply of the cabinet is outstanding; {command!r} was not sent.", command=command)
        now, loop = self._clock.monotonic(), asyncio.get_running_loop()
        replies = [_Awaited(loop.create_future(), now + timeout, sure) for timeout in timeouts]
        self._awaited.extend(replies)
        if self._transport is not None:
            self._transport.write(command.encode("ascii") + END)
        return [each.reply for each in replies]

    async def request(self, command: str, *timeouts: float, sure: bool = False) -> list[str]:
        """Send a command and wait for its replies.

        Args:
            command: Command without its line end.
            *timeouts: One for each reply of the command, s from now.
            sure: True if the reply arrives even if a motion breaks off.

        Raises:
            DeviceRefusedError: The reply is `nak`.
            MotionInterruptedError: The reply is `interrupted`.
            UnknownOutcomeError: The link has failed, or fails now because a reply did not arrive in time.
        """
        replies = self.send(command, *timeouts, sure=sure)
        return [await self._await_reply(reply, timeout) for reply, timeout in zip(replies, timeouts, strict=True)]

    async def start_motion(self, command: str, timeout: float, duration: float) -> asyncio.Future[str]:
        """Send a command whose motion is acknowledged at its start and at its end; return when it has started.

        Until its end, only requests are answered whose reply is sure.

        Args:
            command: Command without its line end.
            timeout: Longest wait for the first reply, s, and for the second one after `duration`.
            duration: Planned duration of the motion, s.

        Returns:
            Future of the reply at the end, with the errors of `request`.

        Raises:
            DeviceRefusedError: The first reply is `nak`.
            MotionInterruptedError: The first reply is `interrupted`.
            UnknownOutcomeError: The link has failed, or fails now because the first reply did not arrive in time.
        """
        (started,) = self.send(command, timeout)
        self._ending = ending = _Awaited(
            asyncio.get_running_loop().create_future(), self._clock.monotonic() + 2.0 * timeout + duration, False
        )
        await self._await_reply(started, timeout)
        ending.deadline = self._clock.monotonic() + duration + timeout
        return ending.reply

    async def request_one_or_two(self, command: str, timeout: float, later: float) -> list[str]:
        """Send a command that has one or two replies; see `request`.

        Args:
            command: Command without its line end.
            timeout: Longest wait for the first reply, s.
            later: Longest time between the two replies, s.
        """
        first, second = self.send(command, timeout, timeout + later, sure=True)
        lines = [await self._await_reply(first, timeout)]
        await self.drain(later)
        return [*lines, second.result()] if second.done() else lines

    async def drain(self, timeout: float) -> None:
        """Wait at most `timeout` s for outstanding replies, then give them up."""
        try:
            async with self._clock.timeout(timeout):
                while self._awaited:
                    await asyncio.wait((self._awaited[0].reply,))
        except TimeoutError:
            self._awaited.clear()

    def check(self) -> None:
        """Check the link, and fail it if a reply is overdue.

        Raises:
            DeviceError: The cabinet has reported this error by itself.
            UnknownOutcomeError: The link has failed.
        """
        if self.notice is not None:
            notice, self.notice = self.notice, None
            raise notice
        outstanding = [*self._awaited, *([] if self._ending is None else [self._ending])]
        if outstanding and self._clock.monotonic() > min(each.deadline for each in outstanding):
            self.fail(SILENT)
        if self.failure is not None:
            raise self._unknown(self.failure)

    def fail(self, why: str) -> UnknownOutcomeError:
        """End the connection; outstanding replies, and later commands, have an unknown outcome."""
        if self.failure is None:
            self.failure = why
            while self._awaited:
                _settle(self._awaited.popleft().reply, self._unknown(why))
            self._end_motion(self._unknown(why))
            if self._transport is not None:
                self._transport.abort()
        return self._unknown(self.failure)

    def close(self, farewell: str) -> None:
        """Send a last command if the link works, and end the connection."""
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

    async def _await_reply(self, reply: asyncio.Future[str], timeout: float) -> str:
        try:
            async with self._clock.timeout(timeout):
                return await asyncio.shield(reply)  # the reply still arrives if its caller is cancelled
        except TimeoutError:
            await asyncio.sleep(0)  # if this process was held up, the reply has arrived and is not read yet
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
        if self._ending is not None and (not self._awaited or self._awaited[0].sure) and (failed or line == DONE):
            self._end_motion(_failure(line) if failed else line)
            return
        if failed and (not self._awaited or self._awaited[0].sure):
            self.notice = _failure(line)
            return
        if not self._awaited:
            raise PayloadError(f"It sent {line[:40]!r} without a request.", line=line[:40])
        reply = self._awaited.popleft().reply
        if failed:
            self._awaited.clear()  # no other reply follows
            self._ending = None
            _settle(reply, _failure(line))
        elif not reply.done():
            reply.set_result(line)

    def _end_motion(self, outcome: str | Exception) -> None:
        """Settle the reply at the end of a motion, if one is outstanding."""
        ending, self._ending = self._ending, None
        if ending is None:
            return
        if isinstance(outcome, Exception):
            _settle(ending.reply, outcome)
        elif not ending.reply.done():
            ending.reply.set_result(outcome)


def _failure(line: str) -> DeviceError:
    if line == REFUSED:
        return DeviceRefusedError("The cabinet refused (nak). Look at the smartPAD: mode, brakes, protective stop.")
    return MotionInterruptedError("The cabinet interrupted the motion. Look at the arm before you continue.")


def _settle(reply: asyncio.Future[str], error: Exception) -> None:
    if not reply.done():  # its caller was cancelled
        reply.set_exception(error)
        reply.exception()  # marks it as retrieved: a caller that does not await it learns of the error otherwise
