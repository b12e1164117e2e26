"""First steps of every driver: reading its table of the configuration, and checking the requested devices."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, TypeVar

import msgspec

from pcmrs.errors import ConfigurationError

__all__ = ["check_devices", "check_names", "read_table"]

S = TypeVar("S", bound=msgspec.Struct)


def read_table(settings: Mapping[str, Any], name: str, kind: type[S]) -> S:
    """Read a table of the configuration; if it is absent, all values are the defaults.

    Args:
        settings: Whole configuration as plain data.
        name: Name of the table.
        kind: Type of the table.

    Raises:
        ConfigurationError: A key is unknown, or a value has the wrong type or is out of range.
    """
    try:
        return msgspec.convert(settings.get(name, {}), kind)
    except msgspec.ValidationError as error:
        raise ConfigurationError(f"The table [{name}] of the configuration is wrong: {error}.") from None


def check_devices(driver: str, requested: Collection[str], served: str) -> None:
    """Check that only the one device is requested that a driver serves.

    Args:
        driver: Name of the driver, for the message.
        requested: Names of the requested devices.
        served: Name of the device that the driver serves.

    Raises:
        ConfigurationError: Another device is requested.
    """
    unknown = sorted(set(requested) - {served})
    if unknown:
        text = f"The driver {driver} serves {served} only, not {', '.join(unknown)}; configure another driver for it."
        raise ConfigurationError(text, unknown=unknown)


def check_names(key: str, names: Mapping[str, str], what: str) -> None:
    """Check a table of external names of bodies: each body needs its own.

    Args:
        key: Key of the table in the configuration.
        names: External name of each body.
        what: Kind of thing that the names denote, such as ``topic``.

    Raises:
        ConfigurationError: There are no names, or two bodies share one.
    """
    if not names or len(set(names.values())) != len(names):
        raise ConfigurationError(f"{key} is {names}; give every body its own {what}.", names=names)
