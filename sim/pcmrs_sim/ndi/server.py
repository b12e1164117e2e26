"""Links to the virtual tracker: a TCP port, as of a Vega, and a pseudo-terminal, as of a serial Polaris."""

from __future__ import annotations

import asyncio
import os
import pty
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING

from pcmrs_sim.ndi.protocol import Lines
from pcmrs_sim.ndi.system import NdiSystem
from pcmrs_sim.tracker import SimTracker

if TYPE_CHECKING:
    from pcmrs_sim.cell import CellSimulation

CHUNK = 4096
LOOPBACK = "127.0.0.1"


@asynccontextmanager
async def serve_ndi(cell: CellSimulation, host: str = LOOPBACK, port: int = 0) -> AsyncIterator[tuple[str, int]]:
    """Serve the tracker of a cell on a TCP port, to any number of clients; yield host and port.

    Args:
        cell: The running cell.
        host: Address to listen on.
        port: TCP port; 0 for any free one.

    Raises:
        OSError: The port is taken.
    """
    system = _system(cell)
    clients: set[asyncio.Task[None]] = set()

    async def serve_client(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        lines = Lines()
        try:
            while data := await reader.read(CHUNK):
                writer.write(_answers(cell, system, lines, data))
                await writer.drain()
        except ConnectionError:
            pass  # the client has gone
        finally:
            writer.close()

    def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.get_running_loop().create_task(serve_client(reader, writer))
        clients.add(task)
        task.add_done_callback(clients.discard)

    server = await asyncio.start_server(accept, host, port)
    try:
        bound = server.sockets[0].getsockname()
        yield bound[0], bound[1]
    finally:
        server.close()
        for client in clients:
            client.cancel()
        await asyncio.gather(*clients, return_exceptions=True)


@asynccontextmanager
async def serve_ndi_pty(cell: CellSimulation) -> AsyncIterator[str]:
    """Serve the tracker of a cell on a pseudo-terminal; yield its path, which clients open as a serial port."""
    system = _system(cell)
    controller, terminal = pty.openpty()
    tty.setraw(terminal)  # the terminal must neither echo nor change bytes
    os.set_blocking(controller, False)
    lines, loop = Lines(), asyncio.get_running_loop()

    def readable() -> None:
        with suppress(BlockingIOError):  # a client that does not read loses replies, and requests them again
            os.write(controller, _answers(cell, system, lines, os.read(controller, CHUNK)))

    loop.add_reader(controller, readable)
    try:
        yield os.ttyname(terminal)
    finally:
        loop.remove_reader(controller)
        os.close(controller)
        os.close(terminal)


def _tracker(cell: CellSimulation) -> SimTracker:
    tracker = cell.devices["tracker"]
    assert isinstance(tracker, SimTracker)
    return tracker


def _system(cell: CellSimulation) -> NdiSystem:
    tracker = _tracker(cell)
    faults = tracker.faults
    return NdiSystem(lambda: tracker.newest, lambda: faults.plugged, lambda: faults.wrong_tools)


def _answers(cell: CellSimulation, system: NdiSystem, lines: Lines, data: bytes) -> bytes:
    """Return the replies to the commands that `data` completes; none while the tracker is silent."""
    commands = lines.feed(data)
    if _tracker(cell).faults.silent:
        return b""
    cell.catch_up()  # a reply holds the newest frame at the time of its command
    return b"".join(system.answer(each) for each in commands)
