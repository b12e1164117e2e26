"""Child processes of the daemon: given its settings, and never left behind."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import structlog

from pcmrs.clock import Clock
from pcmrs.errors import DeviceError
from pcmrs.killing import kill_and_wait
from pcmrs.messages import DeviceEvent
from pcmrs.service.supervisor import RESTARTS, WITHIN, RestartLimit, Supervisor
from pcmrs.settings import Inherited, Settings


async def open_child(
    *words: str, settings: Settings, device_key: bytes = b"", **streams: Any
) -> asyncio.subprocess.Process:
    """Starts ``pcmrs`` with the words as arguments, and hands it `Inherited` on its standard input.

    The pipe stays open: its end tells the child that the daemon is gone, however it went.

    Args:
        words: Of the command line.
        settings: Of the daemon.
        device_key: For a child that speaks as a device, or for the daemon; see `pcmrs.bus.seal`.
        streams: Standard output and error, if they are not the daemon's.

    Raises:
        OSError: It cannot be started.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "pcmrs.cli",
        *words,
        stdin=asyncio.subprocess.PIPE,
        start_new_session=True,  # a Ctrl-C at the terminal is the daemon's to handle
        **streams,
    )
    if process.stdin is None:
        raise DeviceError(f"pcmrs {words[0]} has no standard input.", words=list(words))
    process.stdin.write(msgspec.json.encode(Inherited(settings=settings, device_key=device_key)) + b"\n")
    return process


async def end_child(process: asyncio.subprocess.Process, patience: float) -> bool:
    """Waits for a process that was told to end, and kills it when it does not; whether it ended by itself.

    Args:
        process: The child.
        patience: s of the machine.
    """
    try:
        async with asyncio.timeout(patience):
            await process.wait()
    except TimeoutError:
        await kill_and_wait(process)
        return False
    return True


log = structlog.get_logger(__name__)

ENDING_TIME = 5.0
"""A companion that has not ended so long after it was told to is killed, s."""

_SAID_WHY = 2
"""From this exit status on it has ended for a reason that a new one would end for, too."""


class ChildProcess:
    """A child that ends with its standard input; begun anew when it is killed, never a reason to stop anything.

    Args:
        name: What it does, in events, health and log: ``recording``.
        begin: Starts it. Raises `OSError`.
        report: Told when it has ended by itself.
        clock: The machine's.

    Attributes:
        ended: Why it ended and is not begun anew; empty while it runs, or is not to.
    """

    def __init__(
        self,
        name: str,
        begin: Callable[[], Awaitable[asyncio.subprocess.Process]],
        report: Callable[[DeviceEvent], None],
        clock: Clock,
    ) -> None:
        self._name = name
        self._begin = begin
        self._report = report
        self._clock = clock
        self.ended = ""
        self._process: asyncio.subprocess.Process | None = None

    def start(self, supervisor: Supervisor) -> None:
        """Starts it, and keeps it."""
        supervisor.start(self._name, self._keep)

    async def stop(self) -> None:
        """Lets it finish what it is at, and waits for its end."""
        process = self._process
        if process is None:
            return
        if process.stdin is not None:
            process.stdin.close()
        if not await end_child(process, ENDING_TIME):
            log.warning("companion_killed", name=self._name)

    async def _keep(self) -> None:
        limit = RestartLimit(RESTARTS, WITHIN, self._clock)
        given_up = False
        while not given_up:
            try:
                process = self._process = await self._begin()
            except OSError as error:  # of its folder or the child: no reason to end with the supervisor
                given_up, why = True, error.strerror or str(error)
            else:
                status = await process.wait()
                given_up, why = status >= _SAID_WHY or limit.reached(), f"status {status}"
            log.error("companion_ended", name=self._name, why=why, given_up=given_up)
            self._report(self._event(why, given_up=given_up))
        self.ended = why
        await asyncio.Event().wait()

    def _event(self, why: str, *, given_up: bool) -> DeviceEvent:
        what, then = ("ended", "is not begun anew") if given_up else ("restarted", "is begun anew")
        text = f"The {self._name} ended by itself ({why}) and {then}; the cell works on. The log says more."
        return DeviceEvent(device="daemon", code=f"{self._name}_{what}", text=text, fields={"why": why})
