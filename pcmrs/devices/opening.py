"""Drivers by name, as the installed packages declare them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import AbstractAsyncContextManager
from importlib.metadata import entry_points
from typing import Any

from pcmrs.clock import SystemClock
from pcmrs.devices.protocols import OpenDriver

DRIVERS = "pcmrs.drivers"
"""Group of the entry points that name drivers."""


def open_driver(
    driver: str, devices: Collection[str], table: Mapping[str, Any]
) -> AbstractAsyncContextManager[Mapping[str, Any]]:
    """What opens devices with a driver. One that needs a process of its own may start it already with this call.

    Args:
        driver: Name of an installed driver.
        devices: Devices to open together.
        table: The whole configuration as plain data.
    """
    (point,) = entry_points(group=DRIVERS, name=driver)
    opened: OpenDriver = point.load()
    return opened(devices, table, SystemClock(table.get("cell", {}).get("rate", 1.0)))
