"""The driver `sim`: starts the simulated cell as a child process, and ends if that process ends."""

from __future__ import annotations

import asyncio
import socket
import subprocess
from collections.abc import AsyncIterator, Collection, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

import structlog

from pcmrs.background import background_task
from pcmrs.clock import Clock, SystemClock
from pcmrs.devices.deadman import DEADMAN
from pcmrs.errors import DeviceError
from pcmrs_sim.process.client import WorldClient, devices_of
from pcmrs_sim.process.starting import WorldProcess, start_world

END_TIME = 2.0
"""Time after the end of its link until the world is killed, s: the process may be stopped and cannot end by itself."""

log = structlog.get_logger(__name__)


def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AbstractAsyncContextManager[Mapping[str, Any]]:
    """Start a simulated cell in a separate process, and open devices of it.

    The process starts with this call, and not when the context is entered, because it takes a while to be ready. It
    ends with this process, even if this process is killed.

    Args:
        devices: Names among ``robot``, ``tracker``, ``pointer``, ``scene``, ``stimulator`` and ``emg``.
        settings: The whole configuration; ``sim`` and ``robot`` are read.
        clock: The cell's clock.

    Returns:
        A context with the devices by name. It raises `ConfigurationError` if a device or the arm is unknown, or the
        table ``sim`` is wrong. If the cell ends by itself, it cancels the task that entered it and raises
        `DeviceError`.
    """
    here, there = socket.socketpair()
    with there:
        process = start_world(there, here)
    return _opened(process, here, devices, settings, clock)


@asynccontextmanager
async def _opened(
    process: WorldProcess,
    link: socket.socket,
    devices: Collection[str],
    settings: Mapping[str, Any],
    clock: Clock,
) -> AsyncIterator[Mapping[str, Any]]:
    machine, owner, entered = SystemClock(), asyncio.current_task(), False

    def lost() -> None:
        if entered and owner is not None:  # while the context is being opened, `world.open` fails by itself
            owner.cancel()

    world = WorldClient(link, machine, lost)
    try:
        await world.open(devices, settings)
        async with background_task(world.beat(settings.get("robot", {}).get("deadman", DEADMAN)), "heartbeats"):
            entered = True
            yield devices_of(world, devices, clock)
    except asyncio.CancelledError:
        # Only the cancellation by `lost` becomes an error. Any other one must reach the caller.
        if not world.is_lost or (owner is not None and owner.uncancel() > 0):
            raise
        status = await asyncio.to_thread(_end, process)
        raise DeviceError(f"The simulated cell has ended by itself (status {status}); the log says why.") from None
    finally:
        entered = False
        world.close()
        await asyncio.to_thread(_end, process)


def _end(process: WorldProcess) -> int:
    """Wait for the end of a process, kill it if it does not end, and return its exit status."""
    try:
        return process.wait(END_TIME)
    except subprocess.TimeoutExpired:
        log.warning("simulated_cell_killed")
        process.kill()
        return process.wait()
