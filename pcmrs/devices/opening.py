"""Drivers by name, as the installed packages declare them.

Whether what a driver has opened can do all that a node asks of it: said at the start, not at the first need.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import AbstractAsyncContextManager
from importlib.metadata import entry_points
from typing import Any, Protocol

from pcmrs.clock import SystemClock
from pcmrs.devices.calls import PROTOCOLS
from pcmrs.devices.protocols import OpenDriver
from pcmrs.errors import ConfigurationError


def check_conformity(driver: str, devices: Mapping[str, Any]) -> None:
    """Checks that each device has every method and attribute of its protocol.

    Args:
        driver: Its name, for the message.
        devices: As it has opened them.

    Raises:
        ConfigurationError: One lacks some.
    """
    for name, device in devices.items():
        protocol = PROTOCOLS[name]
        lacking = [each for each in _members(protocol) if not hasattr(device, each)]
        if lacking:
            text = f"The driver {driver!r} has a {name} without {', '.join(lacking)}: "
            text += f"write what pcmrs.devices.protocols.{protocol.__name__} asks for."
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
    """What opens devices with a driver. One that needs a process of its own may start it already with this call.

    Args:
        driver: Name of an installed driver.
        devices: Devices to open together.
        table: The whole configuration as plain data.
    """
    (point,) = entry_points(group=DRIVERS, name=driver)
    opened: OpenDriver = point.load()
    return opened(devices, table, SystemClock(table.get("cell", {}).get("rate", 1.0)))
