"""The virtual cabinet's port: one client at a time, and none that comes too late."""

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
"""So long the application waits for its client, s of the cell; then it ends, and somebody must start it again."""
LOOK = 0.1
"""Between looks whether somebody has, s."""
LONGEST_LINE = 2**16
STREAM = 3
"""Keeps the draws of the replies apart from all others of a seed."""

log = structlog.get_logger(__name__)


@asynccontextmanager
async def serve_kst(
    cell: CellSimulation, host: str = "127.0.0.1", port: int = PORT, *, accept_timeout: float = ACCEPT_TIMEOUT
) -> AsyncIterator[tuple[str, int]]:
    """Serves the arm of `cell` as a KST 1.7 server does; yields where it listens.

    It differs from the real one where that would need a person at the pendant each time: when a client has gone, or has
    sent ``end``, the next one is waited for as at the start.

    Args:
        cell: The running cell.
        host: Address to listen on.
        port: 0 for any.
        accept_timeout: See `ACCEPT_TIMEOUT`; infinity to wait for ever.

    Raises:
        OSError: The port is taken.
        ConfigurationError: The arm is none of such a cabinet.
    """
    check_arm(cell.facts)
    listening = _listen(host, port)
    bound: tuple[str, int] = listening.getsockname()[:2]
    async with background_task(_Server(cell, listening, accept_timeout).run(), "virtual cabinet"):
        yield bound


class _Server:
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
        """The next client; those who come meanwhile wait, unanswered. None when nobody has come in time."""
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
        """Refuses all clients until somebody starts the application again."""
        self._socket.close()
        restarts = self._cell.robot_faults.restarts
        log.warning("cabinet_gave_up", waited=self._accept_timeout, restart="the fault restart_cabinet")
        while self._cell.robot_faults.restarts == restarts:
            await self._cell.clock.sleep(LOOK)
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
                    if self._cell.robot_faults.late and self._last_set_point is not None:
                        cabinet.receive(self._last_set_point)
                    await self._hear(reader, cabinet)
            finally:
                cabinet.leave()
                sending.cancel()
                replies.flush()
                transport.close()
        log.info("cabinet_client_gone")

    async def _hear(self, reader: asyncio.StreamReader, cabinet: SimulatedCabinet) -> None:
        with suppress(ConnectionError, ValueError):  # the client has gone, or sends a line without end
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
