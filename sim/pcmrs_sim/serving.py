"""Virtual devices that the simulated cell serves for drivers of real devices on the same machine."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Mapping
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from typing import Any

import structlog

from pcmrs.hosts import is_this_machine
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.lsl.serving import serve_muscle

LOOPBACK = "127.0.0.1"
PORTS = {"kst": 30001, "ndi": 8765}
"""Default TCP port of each driver's device."""

DEVICES = {"kst": "robot", "ndi": "tracker"}
"""Name of each driver to the name of its device."""

log = structlog.get_logger(__name__)


@asynccontextmanager
async def serve_virtual(cell: CellSimulation, settings: Mapping[str, Any]) -> AsyncIterator[None]:
    """Serve a virtual device for each driver that connects to this machine. Taken ports are skipped with a warning.

    Args:
        cell: The running cell, which all of them share.
        settings: The whole configuration.
    """
    async with AsyncExitStack() as stack:
        for driver, (host, port) in local_addresses(settings).items():
            try:
                bound = await stack.enter_async_context(_serve(driver, cell, host, port))
            except OSError as error:
                reason = error.strerror or str(error)
                log.warning("virtual_device_not_served", driver=driver, host=host, port=port, reason=reason)
            else:
                log.info("virtual_device_served", driver=driver, host=bound[0], port=bound[1])
        await stack.enter_async_context(serve_muscle(cell, settings))
        yield


def local_addresses(settings: Mapping[str, Any]) -> dict[str, tuple[str, int]]:
    """Return the drivers that connect to a device on this machine, each with host and port."""
    addresses = {}
    for driver, device in DEVICES.items():
        if settings.get(device, {}).get("driver") != driver:
            continue
        host, port = address(driver, settings.get(driver, {}))
        if is_this_machine(host):
            addresses[driver] = host, port
    return addresses


def address(driver: str, table: Mapping[str, Any]) -> tuple[str, int]:
    """Return host and port of a driver's device; an empty host for a serial port.

    Args:
        driver: ``kst`` or ``ndi``.
        table: The driver's table of the configuration.
    """
    if driver == "kst":
        return table.get("host", LOOPBACK), table.get("port", PORTS[driver])
    host, _, port = str(table.get("device", f"{LOOPBACK}:{PORTS[driver]}")).rpartition(":")
    return (host, int(port)) if port.isdigit() else ("", 0)


def _serve(driver: str, cell: CellSimulation, host: str, port: int) -> AbstractAsyncContextManager[tuple[str, int]]:
    # Imported here, so that a cell without virtual devices does not load them.
    if driver == "kst":
        from pcmrs_sim.kst.server import serve_kst

        # A cabinet that the daemon serves has nobody at its pendant who could restart the application.
        return serve_kst(cell, host, port, accept_timeout=math.inf)
    from pcmrs_sim.ndi.server import serve_ndi

    return serve_ndi(cell, host, port)
