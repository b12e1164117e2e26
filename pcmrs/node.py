"""The process of a device node: opens a driver's devices and serves them on the bus."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, suppress
from typing import Any

import structlog

from pcmrs.background import background_task
from pcmrs.bus import Bus
from pcmrs.bus.heart import runaway_event
from pcmrs.bus.seal import Seal
from pcmrs.bus.stop import StopLane
from pcmrs.clock import SystemClock
from pcmrs.devices import thread_watcher
from pcmrs.devices.node import DeviceNode
from pcmrs.devices.opening import check_conformity
from pcmrs.killing import kill_and_wait
from pcmrs.processes.starting import ProcessStarter, start_by_exec
from pcmrs.settings import Settings
from pcmrs.threads import Priority, RealTime, Runaway, Threads, keep_pauses_short

ACTING = frozenset({"robot", "stimulator"})
"""Devices that must be able to stop at any time."""
RESTART_PAUSE = 1.0
"""Pause before a watcher of the threads that has ended is restarted, s."""

log = structlog.get_logger(__name__)


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
            if not lifeline:  # the heart of the daemon watches only those that the daemon has started
                device = min(ACTING.intersection(devices))

                def report(runaway: Runaway) -> None:
                    bus.publish(f"dev/{device}/event", runaway_event(device, runaway))

                await stack.enter_async_context(background_task(watch_threads(report), "thread watcher"))
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


async def watch_threads(report: Callable[[Runaway], None], start: ProcessStarter = start_by_exec) -> None:
    """Let another process watch the real-time threads of this one, until cancelled. It is restarted if it ends.

    Args:
        report: Called with each thread that runs away.
        start: Starts the process.
    """
    while True:
        try:
            status: object = await _watch_once(report, start)
        except OSError as error:
            status = str(error)
        log.error("thread_watcher_ended", status=status)
        await SystemClock().sleep(RESTART_PAUSE)


async def _watch_once(report: Callable[[Runaway], None], start: ProcessStarter) -> int:
    process = await start(thread_watcher.__name__, stdout=asyncio.subprocess.PIPE)
    try:
        while process.stdout is not None and (line := await process.stdout.readline()):
            report(Runaway(*json.loads(line)))
        return await process.wait()
    finally:
        await kill_and_wait(process)


def when_input_ends(act: Callable[[], None]) -> None:
    """Call `act` once when standard input ends, or when more data arrives on it."""
    loop, descriptor = asyncio.get_running_loop(), sys.stdin.fileno()

    def readable() -> None:
        loop.remove_reader(descriptor)  # the end of a file stays readable
        act()

    loop.add_reader(descriptor, readable)
