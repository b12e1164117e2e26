"""Links to the virtual tracker: a TCP port, as a Vega has, and a pseudo-terminal, as a serial Polaris seems."""

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
    """Serves the tracker of `cell` on a TCP port, to any number of clients; yields where it listens.

    Raises:
        OSError: The port is taken.
    """
    system = _system(cell)
    clients: set[asyncio.Task[None]] = set()

    async def converse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
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
        task = asyncio.get_running_loop().create_task(converse(reader, writer))
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
    """Serves the tracker of `cell` on a pseudo-terminal; yields its path, to be opened as a serial port."""
    system = _system(cell)
    controller, terminal = pty.openpty()
    tty.setraw(terminal)
    os.set_blocking(controller, False)
    lines, loop = Lines(), asyncio.get_running_loop()

    def readable() -> None:
        with suppress(BlockingIOError):  # of a client that does not read: what it misses, it asks for again
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
    """The replies to what `data` asks, none at all while the tracker is as if it were not there."""
    commands = lines.feed(data)
    if _tracker(cell).faults.silent:
        return b""
    cell.catch_up()  # a frame can be had as soon as it is there
    return b"".join(system.answer(each) for each in commands)
