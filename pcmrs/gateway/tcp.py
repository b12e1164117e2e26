"""The TCP link: the same grammar as a stream, one command per ``;``.

A connection that begins with ``|;`` signs: each of its commands is followed by a signature, which a ``;`` ends too,
``<command>;|<peer>|<counter>|<tag>;``. On any other, each ``;`` ends a command without signature, which begins at once.

Answers go back over the connection, each ended by ``;``: ``ack;``, the second answer, or the verdict reply.
"""

from __future__ import annotations

import asyncio

from pcmrs.errors import PayloadError
from pcmrs.gateway.grammar import MAX_BYTES
from pcmrs.gateway.intake import Intake
from pcmrs.gateway.session import Answer
from pcmrs.gateway.tasks import Tasks
from pcmrs.hosts import is_loopback

LINK = "tcp"
SIGNS = b"|;"
"""With this a connection begins whose commands are signed."""


class TcpLink:
    """Serves any number of connections.

    Args:
        intake: Takes what arrives.
        tasks: Owns the connections.
    """

    def __init__(self, intake: Intake, tasks: Tasks) -> None:
        self._intake = intake
        self._tasks = tasks
        self._server: asyncio.Server
        self._exposed = True

    async def listen(self, host: str, port: int) -> tuple[str, int]:
        """Begins to accept connections; returns the address it is bound to."""
        self._server = await asyncio.start_server(self._connected, host, port, limit=MAX_BYTES)
        bound_host, bound_port = self._server.sockets[0].getsockname()[:2]
        self._exposed = not is_loopback(bound_host)
        return bound_host, bound_port

    def close(self) -> None:
        """Accepts no more connections."""
        self._server.close()

    def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._tasks.spawn(self._serve(reader, writer))

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Reads until the client closes; a frame without an end cannot be skipped, so it ends the connection."""
        host, port = writer.get_extra_info("peername")[:2]
        answer = Answer(verdict=lambda text: _send(writer, text), acknowledge=lambda text: _send(writer, text))
        try:
            first = await reader.readuntil(b";")
            signs = first == SIGNS
            frame = await _signed_frame(reader) if signs else first
            while True:
                self._intake.receive(LINK, (host, port), self._exposed, frame, answer)
                await writer.drain()
                frame = await (_signed_frame(reader) if signs else reader.readuntil(b";"))
        except PayloadError as error:
            self._intake.refuse(LINK, (host, port), error)
        except asyncio.IncompleteReadError as error:
            if error.partial:
                self._intake.refuse(LINK, (host, port), error)
        except asyncio.LimitOverrunError as error:
            self._intake.refuse(LINK, (host, port), error)
        except ConnectionError:
            pass
        finally:
            writer.close()


async def _signed_frame(reader: asyncio.StreamReader) -> bytes:
    """A command and its signature, as one datagram has them.

    Raises:
        PayloadError: The command has no signature, so that nobody knows where the next one begins.
    """
    command = await reader.readuntil(b";")
    try:
        signature = await reader.readuntil(b";")
    except asyncio.IncompleteReadError as error:
        signature = error.partial
    if not (signature.startswith(b"|") and signature.endswith(b";")):
        raise PayloadError(f"{command[:40]!r} has no signature, on a connection that signs; the connection ends.")
    return command + signature.removesuffix(b";")


def _send(writer: asyncio.StreamWriter, text: str) -> None:
    if not writer.is_closing():
        writer.write((text if text.endswith(";") else text + ";").encode("ascii"))
