"""Child processes of the daemon: they get its settings, and never outlive it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import msgspec
import structlog

from pcmrs.clock import Clock
from pcmrs.errors import DeviceError
from pcmrs.killing import kill_and_wait
from pcmrs.messages import DeviceEvent
from pcmrs.processes.starting import Process, ProcessStarter
from pcmrs.service.supervisor import RESTARTS, WITHIN, RestartLimit, Supervisor
from pcmrs.settings import Inherited, Settings


async def open_child(
    start: ProcessStarter,
    *words: str,
    settings: Settings,
    device_key: bytes = b"",
    stdout: int | None = None,
    passed: int | None = None,
) -> Process:
    """Start ``pcmrs`` with some arguments, and send it `Inherited` on its standard input.

    The pipe stays open: its end tells the child that the daemon is gone, even after a crash.

    Args:
        start: Starts the process.
        words: Arguments of the command line.
        settings: Settings of the daemon.
        device_key: Key for a child that speaks as a device, or for the daemon; see `pcmrs.bus.seal`.
        stdout: See `ProcessStarter`.
        passed: See `ProcessStarter`.

    Raises:
        OSError: The process cannot be started.
    """
    process = await start("pcmrs.cli", *words, stdout=stdout, passed=passed)
    if process.stdin is None:
        raise DeviceError(f"pcmrs {words[0]} has no standard input.", words=list(words))
    process.stdin.write(msgspec.json.encode(Inherited(settings=settings, device_key=device_key)) + b"\n")
    return process


async def end_child(process: Process, patience: float) -> bool:
    """Wait for a process that is ending, and kill it if it is late; return whether it has ended by itself.

    Args:
        process: The child.
        patience: Limit, s of the machine.
    """
    try:
        async with asyncio.timeout(patience):
            await process.wait()
    except TimeoutError:
        await kill_and_wait(process)
        return False
    return True


log = structlog.get_logger(__name__)

_SAID_WHY = 2
"""Lowest exit status for a reason that would end a new child, too."""


def _nothing() -> None:
    pass


class ChildProcess:
    """Child that ends with its standard input. It is restarted if it is killed, and never a reason to stop anything.

    Args:
        name: Its task, in events, health and log, such as ``recording``.
        begin: Starts it. Raises `OSError`.
        report: Called if it has ended by itself.
        clock: The machine's clock.
        ending_time: Limit for it to end before it is killed, s of the machine.
        given_up: Called when it has ended and is not restarted.

    Attributes:
        ended: Why it has ended and is not restarted; empty while it runs, or is not meant to.
    """

    def __init__(
        self,
        name: str,
        begin: Callable[[], Awaitable[Process]],
        report: Callable[[DeviceEvent], None],
        clock: Clock,
        ending_time: float,
        given_up: Callable[[], None] = _nothing,
    ) -> None:
        self._ending_time = ending_time
        self._given_up = given_up
        self._name = name
        self._begin = begin
        self._report = report
        self._clock = clock
        self.ended = ""
        self._process: Process | None = None

    def start(self, supervisor: Supervisor) -> None:
        """Start it, and keep it running."""
        supervisor.start(self._name, self._keep)

    async def stop(self) -> None:
        """Let it finish its work, and wait for its end."""
        process = self._process
        if process is None:
            return
        if process.stdin is not None:
            process.stdin.close()
        if not await end_child(process, self._ending_time):
            log.warning("companion_killed", name=self._name)

    async def _keep(self) -> None:
        limit = RestartLimit(RESTARTS, WITHIN, self._clock)
        given_up = False
        while not given_up:
            try:
                process = self._process = await self._begin()
            except OSError as error:  # of its folder or the child: not a reason to end the daemon
                given_up, why = True, error.strerror or str(error)
            else:
                status = await process.wait()
                given_up, why = status >= _SAID_WHY or limit.reached(), f"status {status}"
            log.error("companion_ended", name=self._name, why=why, given_up=given_up)
            self._report(self._event(why, given_up=given_up))
        self.ended = why
        self._given_up()
        await asyncio.Event().wait()

    def _event(self, why: str, *, given_up: bool) -> DeviceEvent:
        what, then = ("ended", "is not restarted") if given_up else ("restarted", "is restarted")
        text = f"The {self._name} ended by itself ({why}) and {then}; the cell works on. The log says more."
        return DeviceEvent(device="daemon", code=f"{self._name}_{what}", text=text, fields={"why": why})
