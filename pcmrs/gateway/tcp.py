"""TCP link: the same grammar as a stream, cut into frames at each ``;``.

A stream that begins with ``|;`` is signed: a frame of it is a command with its signature,
``<command>;|<peer>|<counter>|<tag>;``. In any other stream each ``;`` ends a frame.

Answers go back over the connection, each ended by ``;``: ``ack;``, the second answer, or the verdict reply. The first
byte or frame that breaks the grammar ends the connection: a web page can open one, and the body of its request may hold
commands.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from typing import Any

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.errors import PayloadError, RefusalError
from pcmrs.gateway._arrival import ReceiveQueue, ReceiveWatch
from pcmrs.gateway.grammar import MAX_BYTES, may_become_command
from pcmrs.gateway.intake import ConnectionLimit, Intake
from pcmrs.gateway.peer_session import ReplyChannel
from pcmrs.hosts import is_loopback

SIGNS = b"|;"
"""Beginning of a stream with signed commands."""

_LONGEST_SIGNATURE = 86
_SIGNATURE = re.compile(rb"\|[A-Za-z0-9_|-]*;?")


class Frames:
    """Splitter of a stream into frames.

    A browser, or any other program with another protocol, breaks the grammar at its first line. Its next lines may look
    like a command, so the stream must end at the first wrong byte.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._signed: bool | None = None

    @property
    def unfinished(self) -> bytes:
        """Bytes after the last frame."""
        return self._rest

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield each complete frame, in the form in which a datagram has it.

        Args:
            data: Bytes that have arrived.

        Raises:
            PayloadError: The bytes after the last frame cannot become one. Nothing after them may be read.
        """
        self._rest += data
        while (frame := self._next()) is not None:
            yield frame

    def _next(self) -> bytes | None:
        """Next frame; None if it is not complete."""
        if self._signed is None and not self._opened():
            return None
        command, end, behind = self._rest.partition(b";")
        if not may_become_command(command + end):
            raise PayloadError(f"{_shown(self._rest)} cannot become a command; the connection ends.")
        if not end:
            return None
        if not self._signed:
            self._rest = behind
            return command + end
        signature, second_end, behind = behind.partition(b";")
        self._check_signature(signature + second_end)
        if not second_end:
            return None
        self._rest = behind
        return command + end + signature

    def _opened(self) -> bool:
        """True once it is known whether the stream is signed."""
        if not self._rest or (self._rest != SIGNS and SIGNS.startswith(self._rest)):
            return False
        self._signed = self._rest.startswith(SIGNS)
        if self._signed:
            self._rest = self._rest.removeprefix(SIGNS)
        return True

    def _check_signature(self, text: bytes) -> None:
        if text and not (len(text) <= _LONGEST_SIGNATURE + 1 and _SIGNATURE.fullmatch(text)):
            raise PayloadError(
                f"{_shown(self._rest)} has no signature, on a connection that signs; the connection ends."
            )


def _shown(data: bytes) -> str:
    return repr(data[:40])


LINK = "tcp"
MOST = 32
"""Limit of open connections."""
MOST_OF_A_HOST = 8
"""Limit of open connections from one address."""
FIRST_WITHIN = 10.0
"""Limit after which a peer that must sign, but has sent no signed frame, is disconnected, s of the machine."""
SILENT = "not_authenticated"


class _CountingReader(asyncio.StreamReader):
    """Reader of a connection that counts what was read from the socket and is not taken yet.

    Args:
        queue: Received data of the connection.
    """

    def __init__(self, queue: ReceiveQueue) -> None:
        super().__init__(MAX_BYTES, asyncio.get_running_loop())
        self.queue = queue

    def feed_data(self, data: Any) -> None:
        self.queue.buffered += len(data)
        super().feed_data(data)

    async def read(self, n: int = -1) -> bytes:
        data = await super().read(n)
        self.queue.buffered -= len(data)
        return data


class TcpLink:
    """Server of a bounded number of connections.

    Args:
        intake: Intake of the commands.
        tasks: Owner of the connections' tasks.
        clock: The machine's clock.
        watch: Knows when bytes have arrived.
    """

    def __init__(self, intake: Intake, tasks: BackgroundTasks, clock: Clock, watch: ReceiveWatch) -> None:
        self._intake = intake
        self._watch = watch
        self._opened = watch.new_queue().since
        self._accepting: list[ReceiveQueue] = []
        self._tasks = tasks
        self._clock = clock
        self._server: asyncio.Server
        self._exposed = True
        self._limit = ConnectionLimit(LINK, intake, MOST, MOST_OF_A_HOST)

    async def listen(self, host: str, port: int) -> tuple[str, int]:
        """Start to accept connections; return the address that is bound.

        Args:
            host: Host to bind.
            port: Port to bind; 0 takes any free one.
        """
        self._server = await asyncio.get_running_loop().create_server(self._protocol, host, port)
        for listening in self._server.sockets:
            self._accepting.append(ReceiveQueue(self._opened))
            self._watch.add(self._accepting[-1], listening.fileno())
        bound_host, bound_port = self._server.sockets[0].getsockname()[:2]
        self._exposed = not is_loopback(bound_host)
        return bound_host, bound_port

    def close(self) -> None:
        """Stop accepting connections."""
        for queue in self._accepting:
            self._watch.remove(queue)
        self._server.close()

    def _protocol(self) -> asyncio.StreamReaderProtocol:
        # The first bytes may have arrived while the connection waited to be accepted. The last time but one counts,
        # because the queue of connections may have been found empty since this one was taken from it.
        since = min((queue.before for queue in self._accepting), default=self._opened)
        reader = _CountingReader(ReceiveQueue(since))

        def connected(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            self._connected(reader, writer)

        return asyncio.StreamReaderProtocol(reader, connected, asyncio.get_running_loop())

    def _connected(self, reader: _CountingReader, writer: asyncio.StreamWriter) -> None:
        peer = self._limit.take(writer)
        if peer is not None:
            self._watch.add(reader.queue, writer.get_extra_info("socket").fileno())
            self._tasks.spawn(self._serve(reader, writer, peer))

    async def _serve(self, reader: _CountingReader, writer: asyncio.StreamWriter, peer: tuple[str, int]) -> None:
        """Read until the peer closes, breaks the grammar, or fails to authenticate in time."""
        connection = _Connection(self._intake, self._watch, reader, writer, peer, self._exposed)
        try:
            async with self._clock.timeout(FIRST_WITHIN):
                while not connection.known and await connection.read():
                    pass
            while await connection.read():
                pass
        except TimeoutError:
            text = f"No signed frame came within {FIRST_WITHIN:g} s; the connection ends. Connect again, and sign."
            self._intake.refuse(LINK, peer, RefusalError(SILENT, text, limit=FIRST_WITHIN))
        except PayloadError as error:
            self._intake.refuse(LINK, peer, error)
        except ConnectionError:
            pass
        finally:
            self._limit.free(peer)
            self._watch.remove(reader.queue)
            writer.close()


class _Connection:
    """One connection.

    Attributes:
        known: The peer is configured, or one of its signatures was right.
    """

    def __init__(
        self,
        intake: Intake,
        watch: ReceiveWatch,
        reader: _CountingReader,
        writer: asyncio.StreamWriter,
        peer: tuple[str, int],
        exposed: bool,
    ) -> None:
        self._intake = intake
        self._watch = watch
        self._reader = reader
        self._writer = writer
        self._peer = peer
        self._exposed = exposed
        self._frames = Frames()
        self._answer = ReplyChannel(verdict=self._send, acknowledge=self._send)
        self.known = intake.takes_unsigned(peer[0], exposed)

    async def read(self) -> bool:
        """Take the frames that have arrived; return False if there will be no more.

        Raises:
            PayloadError: The grammar is broken between two frames, or the last one is not complete.
            ConnectionError: The peer is gone.
        """
        data = await self._reader.read(MAX_BYTES)
        arrived = self._reader.queue.since
        for frame in self._frames.feed(data):
            error = self._intake.receive(LINK, self._peer, self._exposed, frame, self._answer, arrived)
            if isinstance(error, PayloadError):
                return False
            self.known = self.known or error is None
            await self._writer.drain()
        self._watch.look_at(self._reader.queue)
        if not data and self._frames.unfinished:
            raise PayloadError(f"{self._frames.unfinished[:40]!r} is not a complete frame.")
        return bool(data)

    def _send(self, text: str) -> None:
        if not self._writer.is_closing():
            self._writer.write((text if text.endswith(";") else text + ";").encode("ascii"))
