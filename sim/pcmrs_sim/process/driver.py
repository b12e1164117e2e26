"""The driver `sim`: starts the simulated cell as a child process, and ends with it."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Collection, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

import structlog

from pcmrs.background import background_task
from pcmrs.clock import Clock, SystemClock
from pcmrs.devices.deadman import DEADMAN
from pcmrs.errors import DeviceError
from pcmrs_sim.process.client import WorldClient, devices_of

MODULE = "pcmrs_sim.process"
END_TIME = 2.0
"""A world that has not ended so long after its link is killed, s: it may be stopped."""

log = structlog.get_logger(__name__)


def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AbstractAsyncContextManager[Mapping[str, Any]]:
    """Starts a simulated cell in a process of its own, and opens the asked devices of it.

    The process begins with this call, not with the context, for it needs a while to be ready. It ends with this
    process, however that ends.

    Args:
        devices: Among ``robot``, ``tracker``, ``pointer``, ``scene``, ``stimulator`` and ``emg``.
        settings: The whole configuration; ``sim`` and ``robot`` are read.
        clock: The cell's clock.

    Returns:
        A context that raises `ConfigurationError` when a device or the arm is unknown, or the table ``sim`` is wrong.
        When the cell ends by itself, it cancels the task that has entered it, and raises `DeviceError`.
    """
    here, there = socket.socketpair()
    with there:
        # In a session of its own: a Ctrl-C at the terminal is the node's to handle.
        process = subprocess.Popen([sys.executable, "-m", MODULE], stdin=there.fileno(), start_new_session=True)
    return _opened(process, here, devices, settings, clock)


@asynccontextmanager
async def _opened(
    process: subprocess.Popen[bytes],
    link: socket.socket,
    devices: Collection[str],
    settings: Mapping[str, Any],
    clock: Clock,
) -> AsyncIterator[Mapping[str, Any]]:
    machine, owner, entered = SystemClock(), asyncio.current_task(), False

    def lost() -> None:
        if entered and owner is not None:
            owner.cancel()

    world = WorldClient(link, machine, lost)
    try:
        await world.open(devices, settings)
        async with background_task(world.beat(settings.get("robot", {}).get("deadman", DEADMAN)), "signs of life"):
            entered = True
            yield devices_of(world, devices, clock)
    except asyncio.CancelledError:
        if not world.is_lost or (owner is not None and owner.uncancel() > 0):
            raise
        status = await asyncio.to_thread(_end, process)
        raise DeviceError(f"The simulated cell has ended by itself (status {status}); the log says why.") from None
    finally:
        entered = False
        world.close()
        await asyncio.to_thread(_end, process)


def _end(process: subprocess.Popen[bytes]) -> int:
    """Waits for the end of a process, kills it when that does not come, and returns its exit status."""
    try:
        return process.wait(END_TIME)
    except subprocess.TimeoutExpired:
        log.warning("simulated_cell_killed")
        process.kill()
        return process.wait()
