"""A program as Slicer is one: one thread, a Qt event loop and a timer; beside it a daemon, and a lossy way to it."""

from __future__ import annotations

import asyncio
import importlib
import select
import socket
import sys
import threading
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from pcmrs.testing.cell import RunningCell, open_cell
from pcmrs.testing.daemon import free_port
from tests import ROOT

MODULE = ROOT / "clients" / "slicer" / "PcmrsPlanner"
TICK_MS = 15
PATIENCE = 30.0

T = TypeVar("T")


def core() -> Any:
    """The module's core, found as Slicer finds it: beside the module."""
    if str(MODULE) not in sys.path:
        sys.path.append(str(MODULE))
    return importlib.import_module("pcmrs_link")


class Program:
    """An event loop whose precise timer calls what is to tick.

    Args:
        qt: ``PySide6.QtCore``.
        ticking: Called at each tick of the timer.
    """

    def __init__(self, qt: Any, *ticking: Callable[[], None]) -> None:
        self._qt = qt
        self._ticking = ticking
        self._application = qt.QCoreApplication.instance() or qt.QCoreApplication([])

    def until(self, condition: Callable[[], bool], within: float = PATIENCE) -> None:
        """Runs the event loop until a condition holds after a tick; an error in a tick is raised here."""
        loop, errors, late = self._qt.QEventLoop(), [], []

        def tick() -> None:
            try:
                for each in self._ticking:
                    each()
                if condition():
                    loop.quit()
            except BaseException as error:  # what leaves a slot is printed and forgotten by Qt
                errors.append(error)
                loop.quit()

        def give_up() -> None:
            late.append(True)
            loop.quit()

        timer, deadline = self._qt.QTimer(), self._qt.QTimer()
        timer.setTimerType(self._qt.Qt.TimerType.PreciseTimer)
        timer.setInterval(TICK_MS)
        timer.timeout.connect(tick)
        deadline.setSingleShot(True)
        deadline.setInterval(int(within * 1e3))
        deadline.timeout.connect(give_up)
        timer.start()
        deadline.start()
        loop.exec()
        timer.stop()
        deadline.stop()
        if errors:
            raise errors[0]
        assert not late, "it did not come about in time"

    def verdict(self, begin: Callable[..., None], *arguments: Any) -> Any:
        """Begins a job and returns the verdict that ended it."""
        answers: list[Any] = []
        begin(*arguments, then=answers.append)
        self.until(lambda: bool(answers))
        return answers[0]


class Cell:
    """A daemon and a client on its bus, driven by a thread of their own.

    Attributes:
        cell: As the campaign has it.
        pose_port: Where it sends poses of the tool.
        point_port: Where it sends the pointer's tip.
    """

    def __init__(self, cell: RunningCell, loop: asyncio.AbstractEventLoop, ports: tuple[int, int]) -> None:
        self.cell = cell
        self.pose_port, self.point_port = ports
        self._loop = loop

    @property
    def port(self) -> int:
        return self.cell.ready.links["planner"][1]

    @property
    def feed_port(self) -> int:
        return self.cell.ready.links["openigtlink"][1]

    def ask(self, question: Coroutine[Any, Any, T]) -> T:
        """What a coroutine on the bus returns."""
        return asyncio.run_coroutine_threadsafe(question, self._loop).result(PATIENCE)

    def outcomes(self, source: str, after: int = 0) -> list[str]:
        """What the journal says that clients of a kind have had done after a row, in order: each outcome once."""
        rows = [row for row in self.cell.rows(after) if row.kind == "outcome" and (row.source or "").startswith(source)]
        return [f"{row.verdict.decision} {row.branch}.{row.operation}" for row in rows if row.verdict is not None]


@contextmanager
def running_cell(folder: Path, *overrides: str) -> Iterator[Cell]:
    """A real daemon with streams on ports of their own and OpenIGTLink, for the length of the context."""
    ports = free_port(), free_port()
    settings = (
        f"gateway.visualization.stream_port={ports[0]}",
        f"gateway.planner.stream_port={ports[1]}",
        "gateway.openigtlink.enabled=true",
        "gateway.openigtlink.port=0",
        *overrides,
    )
    opened: Future[Cell] = Future()
    ended = threading.Event()

    async def serve() -> None:
        try:
            async with open_cell(folder, settings) as cell:
                opened.set_result(Cell(cell, asyncio.get_running_loop(), ports))
                await asyncio.to_thread(ended.wait)
        except BaseException as error:
            if not opened.done():
                opened.set_exception(error)
            raise

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    try:
        yield opened.result()
    finally:
        ended.set()
        thread.join()


@contextmanager
def lossy_way(port: int, lost: Callable[[str, bytes], bool], host: str = "127.0.0.1") -> Iterator[int]:
    """A port that passes datagrams on to another of this machine, and back, but for those that are lost.

    Args:
        port: The daemon's.
        lost: Asked with ``to`` or ``from`` (the daemon) and the datagram.
        host: Where the daemon sees it come from.
    """
    here = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    there = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    here.bind(("127.0.0.1", 0))
    there.bind((host, 0))
    there.connect(("127.0.0.1", port))
    ended = threading.Event()

    def pass_on() -> None:
        client: Any = None
        while not ended.is_set():
            for ready in select.select([here, there], [], [], 0.05)[0]:
                data, sender = ready.recvfrom(2048)
                client = sender if ready is here else client
                if ready is here and not lost("to", data):
                    there.send(data)
                elif ready is there and not lost("from", data):
                    here.sendto(data, client)

    thread = threading.Thread(target=pass_on)
    thread.start()
    try:
        yield here.getsockname()[1]
    finally:
        ended.set()
        thread.join()
        here.close()
        there.close()
