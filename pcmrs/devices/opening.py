"""Opening of devices by the name of their driver, as installed packages declare it.

`check_conformity` finds missing methods of a driver at the start, not at their first use.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import AbstractAsyncContextManager
from typing import Any, Protocol

from pcmrs.clock import SystemClock
from pcmrs.devices.calls import PROTOCOLS
from pcmrs.devices.protocols import OpenDriver
from pcmrs.errors import ConfigurationError
from pcmrs.installed import entry_points_of

__all__ = ["DRIVERS", "check_conformity", "open_driver"]


def check_conformity(driver: str, devices: Mapping[str, Any]) -> None:
    """Check that each device has every method and attribute of its protocol.

    Args:
        driver: Name of the driver, for the message.
        devices: Devices that it has opened, by name.

    Raises:
        ConfigurationError: A device lacks a method or attribute.
    """
    for name, device in devices.items():
        protocol = PROTOCOLS[name]
        lacking = [each for each in _members(protocol) if not hasattr(device, each)]
        if lacking:
            text = f"The driver {driver!r} has a {name} without {', '.join(lacking)}: "
            text += f"implement pcmrs.devices.protocols.{protocol.__name__} as a whole."
            raise ConfigurationError(text, driver=driver, device=name, lacking=lacking)


def _members(protocol: type) -> Iterator[str]:
    for each in protocol.__mro__:
        if each not in (object, Protocol) and Protocol in each.__mro__:
            yield from (name for name in vars(each) if not name.startswith("_"))


DRIVERS = "pcmrs.drivers"
"""Group of the entry points that name drivers."""


def open_driver(
    driver: str, devices: Collection[str], table: Mapping[str, Any]
) -> AbstractAsyncContextManager[Mapping[str, Any]]:
    """Return the context that opens devices. A driver that needs its own process may start it with this call.

    Args:
        driver: Name of an installed driver.
        devices: Devices to open together.
        table: Whole configuration as plain data.
    """
    (point,) = (each for each in entry_points_of(DRIVERS) if each.name == driver)
    opened: OpenDriver = point.load()
    return opened(devices, table, SystemClock(table.get("cell", {}).get("rate", 1.0)))
