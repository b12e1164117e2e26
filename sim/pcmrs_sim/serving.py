"""The virtual devices that the simulated cell serves by itself, for drivers of real devices on the same machine."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Mapping
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from ipaddress import ip_address
from typing import Any

import structlog

from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.lsl.serving import serve_muscle

LOOPBACK = "127.0.0.1"
PORTS = {"kst": 30001, "ndi": 8765}
"""Where a device is looked for, and so served, unless its driver's table says otherwise."""

DEVICES = {"kst": "robot", "ndi": "tracker"}
"""Which device each driver drives."""

log = structlog.get_logger(__name__)


@asynccontextmanager
async def serve_virtual(cell: CellSimulation, settings: Mapping[str, Any]) -> AsyncIterator[None]:
    """Serves a virtual device for each driver that looks for its device on this machine; a taken port is left alone.

    Args:
        cell: The one world that all of them share.
        settings: The whole configuration.
    """
    async with AsyncExitStack() as stack:
        for driver, (host, port) in wanted(settings).items():
            try:
                bound = await stack.enter_async_context(_serve(driver, cell, host, port))
            except OSError as error:
                reason = error.strerror or str(error)
                log.warning("virtual_device_not_served", driver=driver, host=host, port=port, reason=reason)
            else:
                log.info("virtual_device_served", driver=driver, host=bound[0], port=bound[1])
        await stack.enter_async_context(serve_muscle(cell, settings))
        yield


def wanted(settings: Mapping[str, Any]) -> dict[str, tuple[str, int]]:
    """Drivers whose device is looked for on this machine, and where."""
    found = {}
    for driver, device in DEVICES.items():
        if settings.get(device, {}).get("driver") != driver:
            continue
        host, port = address(driver, settings.get(driver, {}))
        if _is_loopback(host):
            found[driver] = host, port
    return found


def address(driver: str, table: Mapping[str, Any]) -> tuple[str, int]:
    """Where the driver looks for its device; a serial port is no address of ours."""
    if driver == "kst":
        return table.get("host", LOOPBACK), table.get("port", PORTS[driver])
    host, _, port = str(table.get("device", f"{LOOPBACK}:{PORTS[driver]}")).rpartition(":")
    return (host, int(port)) if port.isdigit() else ("", 0)


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def _serve(driver: str, cell: CellSimulation, host: str, port: int) -> AbstractAsyncContextManager[tuple[str, int]]:
    if driver == "kst":
        from pcmrs_sim.kst.server import serve_kst

        # Nobody stands at the pendant of a cabinet that comes with the daemon.
        return serve_kst(cell, host, port, accept_timeout=math.inf)
    from pcmrs_sim.ndi.server import serve_ndi

    return serve_ndi(cell, host, port)
