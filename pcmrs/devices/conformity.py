"""Whether what a driver has opened can do all that a node asks of it: said at the start, not at the first need."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

from pcmrs.devices.calls import PROTOCOLS
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
