"""The process of a device node: opens a driver's devices and serves them on the bus."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, suppress
from typing import Any

from pcmrs.background import background_task
from pcmrs.bus import Bus
from pcmrs.bus.seal import Seal
from pcmrs.bus.stop import StopLane
from pcmrs.clock import SystemClock
from pcmrs.devices.node import DeviceNode
from pcmrs.devices.opening import check_conformity
from pcmrs.settings import Settings
from pcmrs.threads import Priority, RealTime, Threads, keep_pauses_short

ACTING = frozenset({"robot", "stimulator"})
"""Devices that must be able to stop at any time."""


async def serve_devices(
    settings: Settings,
    driver: str,
    devices: Sequence[str],
    opening: AbstractAsyncContextManager[Mapping[str, Any]],
    device_key: bytes,
    *,
    lifeline: bool,
) -> None:
    """Serve devices until SIGTERM or SIGINT.

    Args:
        settings: Configuration of the cell.
        driver: Name of the driver.
        devices: Names of the devices to serve.
        opening: Context that opens them; see `pcmrs.devices.opening.open_driver`.
        device_key: Key with which daemon and nodes seal their messages.
        lifeline: True to end when standard input ends, too: with the daemon that started this process.

    Raises:
        BusError: The daemon does not answer.
        ConfigurationError: The driver refuses its settings, or a device lacks a method of its protocol.
        DeviceError: The driver has failed for good.
    """
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    if lifeline:
        when_input_ends(ended.set)
    async with AsyncExitStack() as stack:
        bus = await Bus.open(settings.bus("client"), Seal(device_key))
        stack.push_async_callback(bus.close)
        opened = await stack.enter_async_context(opening)
        check_conformity(driver, opened)
        node = DeviceNode(bus, opened, SystemClock(), settings.robot.deadman, Threads())
        lane = await StopLane.open(settings.bus("client"), lambda source, _: node.stop(source))
        stack.push_async_callback(lane.close)
        bus.alive(f"node-{driver}")
        if ACTING.intersection(devices):
            keep_pauses_short()
            realtime = RealTime(Priority.DEVICE)
            await stack.enter_async_context(background_task(realtime.keep(SystemClock().sleep), "real-time policy"))
        serving = asyncio.create_task(node.run())
        ending = asyncio.create_task(ended.wait())
        try:
            await asyncio.wait([serving, ending], return_when=asyncio.FIRST_COMPLETED)
        finally:  # a driver that has failed for good cancels this task
            await node.make_safe("the node ends")
            ending.cancel()
            serving.cancel()
            with suppress(asyncio.CancelledError):
                await serving


def when_input_ends(act: Callable[[], None]) -> None:
    """Call `act` once when standard input ends, or when more data arrives on it."""
    loop, descriptor = asyncio.get_running_loop(), sys.stdin.fileno()

    def readable() -> None:
        loop.remove_reader(descriptor)  # the end of a file stays readable
        act()

    loop.add_reader(descriptor, readable)
