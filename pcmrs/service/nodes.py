"""The device nodes of this machine, as child processes of the daemon."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from contextlib import suppress

import msgspec
import structlog

from pcmrs.errors import DeviceError
from pcmrs.settings import Settings

log = structlog.get_logger(__name__)

TERMINATION_TIME = 3.0
"""A node that has not ended so long after SIGTERM is killed, s."""


class NodeProcesses:
    """Starts one process per driver, notices when one ends, and ends them all.

    Args:
        settings: Handed to every node on its standard input.
        on_end: Called with the names of the devices whose node has ended by itself.
    """

    def __init__(self, settings: Settings, on_end: Callable[[list[str]], None]) -> None:
        self._settings = settings
        self._on_end = on_end
        self._processes: dict[str, asyncio.subprocess.Process] = {}
        self._watchers: list[asyncio.Task[None]] = []

    async def start(self) -> None:
        """Starts the nodes of all configured drivers."""
        for driver, devices in self._settings.drivers().items():
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                "pcmrs.cli",
                "node",
                driver,
                *devices,
                stdin=asyncio.subprocess.PIPE,
                start_new_session=True,  # a Ctrl-C at the terminal is the daemon's to handle
            )
            if process.stdin is None:
                raise DeviceError(f"The node of {driver} has no standard input.", driver=driver)
            # The pipe stays open: its end tells the node that the daemon is gone, however it went.
            process.stdin.write(msgspec.json.encode(self._settings) + b"\n")
            self._processes[driver] = process
            self._watchers.append(asyncio.create_task(self._watch(driver, devices, process)))

    async def stop(self) -> None:
        """Ends all nodes: SIGTERM, then SIGKILL."""
        for watcher in self._watchers:
            watcher.cancel()
        await asyncio.gather(*self._watchers, return_exceptions=True)
        for process in self._processes.values():
            with suppress(ProcessLookupError):
                process.terminate()
        for driver, process in self._processes.items():
            try:
                async with asyncio.timeout(TERMINATION_TIME):
                    await process.wait()
            except TimeoutError:
                log.warning("node_killed", driver=driver)
                process.kill()
                await process.wait()

    async def _watch(self, driver: str, devices: list[str], process: asyncio.subprocess.Process) -> None:
        status = await process.wait()
        log.error("node_ended", driver=driver, devices=devices, status=status)
        self._on_end(devices)
