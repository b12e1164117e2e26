"""The process of a device node: opens a driver's devices and serves them on the bus."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack, suppress
from importlib.metadata import entry_points

from pcmrs.background import meanwhile
from pcmrs.bus import Bus
from pcmrs.bus.seal import Seal
from pcmrs.bus.stop import StopLane
from pcmrs.clock import SystemClock
from pcmrs.config import as_table
from pcmrs.devices.node import DeviceNode
from pcmrs.devices.protocols import OpenDriver
from pcmrs.settings import DRIVERS, SIMULATION, Settings
from pcmrs.threads import Priority, RealTime, Threads

ACTING = frozenset({"robot", "stimulator"})
"""Devices that somebody must be able to stop at any time."""


async def serve_devices(
    settings: Settings, driver: str, devices: Sequence[str], device_key: bytes, *, lifeline: bool
) -> None:
    """Serves `devices` with `driver` until SIGTERM or SIGINT.

    Args:
        settings: The cell's configuration.
        driver: Name of an installed driver.
        devices: Devices to open together.
        device_key: With which daemon and nodes seal what they send each other.
        lifeline: Also ends when standard input ends: with the daemon that started this process.

    Raises:
        BusError: The daemon does not answer.
        ConfigurationError: The driver refuses its settings.
    """
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    if lifeline:
        when_input_ends(ended.set)
    (point,) = entry_points(group=DRIVERS, name=driver)
    open_driver: OpenDriver = point.load()
    clock = SystemClock(settings.cell.rate)
    async with AsyncExitStack() as stack:
        bus = await Bus.open(settings.bus("client"), Seal(device_key))
        stack.push_async_callback(bus.close)
        opened = await stack.enter_async_context(open_driver(devices, as_table(settings), clock))
        node = DeviceNode(bus, opened, SystemClock(), settings.robot.deadman, Threads())
        lane = await StopLane.open(settings.bus("client"), lambda source, _: node.stop(source))
        stack.push_async_callback(lane.close)
        bus.alive(f"node-{driver}")
        if ACTING.intersection(devices):
            # The simulated cell computes in this process: only the threads of the bus go ahead of others then.
            realtime = RealTime(Priority.DEVICE, main=driver != SIMULATION)
            await stack.enter_async_context(meanwhile(realtime.keep(SystemClock().sleep), "real-time policy"))
        serving = asyncio.create_task(node.run())
        ending = asyncio.create_task(ended.wait())
        await asyncio.wait([serving, ending], return_when=asyncio.FIRST_COMPLETED)
        await node.make_safe("the node ends")
        ending.cancel()
        serving.cancel()
        with suppress(asyncio.CancelledError):
            await serving


def when_input_ends(act: Callable[[], None]) -> None:
    """Calls `act` once when standard input ends, or anything more arrives on it."""
    loop, descriptor = asyncio.get_running_loop(), sys.stdin.fileno()

    def readable() -> None:
        loop.remove_reader(descriptor)  # the end of a file stays readable
        act()

    loop.add_reader(descriptor, readable)
