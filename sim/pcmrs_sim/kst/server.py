"""The virtual cabinet's port: one client at a time, and none after a timeout."""

from __future__ import annotations

import asyncio
import math
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import numpy as np
import structlog

from pcmrs.background import background_task
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.cabinet import SimulatedCabinet, check_arm
from pcmrs_sim.kst.replies import Replies

PORT = 30001
ACCEPT_TIMEOUT = 60.0
"""Time for which the application waits for a client, s of the cell. Then it ends, and a person must restart it."""
RESTART_POLL_PERIOD = 0.1
"""Period of polls for that restart, s of the cell."""
LONGEST_LINE = 2**16
"""Length at which a line without end closes the connection, bytes."""
STREAM = 3
"""Number of the random stream of the replies, so that it is independent of the other streams of a seed."""

log = structlog.get_logger(__name__)


@asynccontextmanager
async def serve_kst(
    cell: CellSimulation, host: str = "127.0.0.1", port: int = PORT, *, accept_timeout: float = ACCEPT_TIMEOUT
) -> AsyncIterator[tuple[str, int]]:
    """Serve the arm of a cell as a KST 1.7 server does; yield host and port.

    It differs from the real one where that would need a person at the pendant each time: after a client has gone, or
    has sent ``end``, it waits for the next one as at the start.

    Args:
        cell: The running cell.
        host: Address to listen on.
        port: TCP port; 0 for any free one.
        accept_timeout: See `ACCEPT_TIMEOUT`; infinity for no timeout.

    Raises:
        OSError: The port is taken.
        ConfigurationError: A cabinet cannot move this arm.
    """
    check_arm(cell.facts)
    listening = _listen(host, port)
    bound: tuple[str, int] = listening.getsockname()[:2]
    async with background_task(_Server(cell, listening, accept_timeout).run(), "virtual cabinet"):
        yield bound


class _Server:
    """The application of the cabinet: accepts one client after the other.

    Args:
        cell: The running cell.
        listening: Socket that listens; closed at the end.
        accept_timeout: See `ACCEPT_TIMEOUT`.
    """

    def __init__(self, cell: CellSimulation, listening: socket.socket, accept_timeout: float) -> None:
        self._cell, self._socket, self._accept_timeout = cell, listening, accept_timeout
        self._address = listening.getsockname()[:2]
        self._rng = np.random.default_rng((cell.world.settings.seed, STREAM))
        self._last_set_point: str | None = None

    async def run(self) -> None:
        try:
            while True:
                connection = await self._accept()
                if connection is None:
                    await self._wait_for_restart()
                else:
                    await self._converse(connection)
        finally:
            self._socket.close()

    async def _accept(self) -> socket.socket | None:
        """Return the connection of the next client; None after the timeout. Further clients wait without an answer."""
        accepting = asyncio.ensure_future(asyncio.get_running_loop().sock_accept(self._socket))
        if math.isinf(self._accept_timeout):
            return (await accepting)[0]
        waiting = asyncio.ensure_future(self._cell.clock.sleep(self._accept_timeout))
        try:
            await asyncio.wait((accepting, waiting), return_when=asyncio.FIRST_COMPLETED)
            return accepting.result()[0] if accepting.done() else None
        finally:
            waiting.cancel()
            accepting.cancel()

    async def _wait_for_restart(self) -> None:
        """Refuse all clients until the fault `restart_cabinet` restarts the application."""
        self._socket.close()
        restarts = self._cell.robot_faults.restarts
        log.warning("cabinet_gave_up", waited=self._accept_timeout, restart="the fault restart_cabinet")
        while self._cell.robot_faults.restarts == restarts:
            await self._cell.clock.sleep(RESTART_POLL_PERIOD)
        self._socket = _listen(*self._address)

    async def _converse(self, connection: socket.socket) -> None:
        reader = asyncio.StreamReader(LONGEST_LINE)
        protocol = asyncio.StreamReaderProtocol(reader)
        loop = asyncio.get_running_loop()
        transport, _ = await loop.connect_accepted_socket(lambda: protocol, connection)
        writer = asyncio.StreamWriter(transport, protocol, reader, loop)
        replies = Replies(writer, self._cell.robot_faults, self._cell.clock, self._rng)
        cabinet = SimulatedCabinet(self._cell, replies.send, transport.abort)
        log.info("cabinet_client", peer=writer.get_extra_info("peername"))
        async with asyncio.TaskGroup() as tasks:
            sending = tasks.create_task(replies.run(), name="replies of the virtual cabinet")
            try:
                with self._cell.watched(cabinet.update):
                    # The fault `late`: a set point that was delayed in the network reaches the next connection.
                    if self._cell.robot_faults.late and self._last_set_point is not None:
                        cabinet.receive(self._last_set_point)
                    await self._read_lines(reader, cabinet)
            finally:
                cabinet.leave()
                sending.cancel()
                replies.flush()
                transport.close()
        log.info("cabinet_client_gone")

    async def _read_lines(self, reader: asyncio.StreamReader, cabinet: SimulatedCabinet) -> None:
        with suppress(ConnectionError, ValueError):  # the client has gone, or sent a line that is too long
            while data := await reader.readline():
                self._cell.catch_up()
                line = data.decode("latin-1").rstrip("\r\n")
                if line.startswith("jf_"):
                    self._last_set_point = line
                for _ in range(2 if self._cell.robot_faults.doubled else 1):
                    cabinet.receive(line)


def _listen(host: str, port: int) -> socket.socket:
    family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)  # asyncio turns Nagle off by this number
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
        listening.listen(1)
    except OSError:
        listening.close()
        raise
    listening.setblocking(False)
    return listening
