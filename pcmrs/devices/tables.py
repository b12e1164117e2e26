"""What every driver does first: reads its own table of the configuration, and looks at what it is to serve."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, TypeVar

import msgspec

from pcmrs.errors import ConfigurationError

S = TypeVar("S", bound=msgspec.Struct)


def read_table(settings: Mapping[str, Any], name: str, kind: type[S]) -> S:
    """The table of that name; absent means all defaults.

    Raises:
        ConfigurationError: A key is unknown, or a value has the wrong type or is out of range.
    """
    try:
        return msgspec.convert(settings.get(name, {}), kind)
    except msgspec.ValidationError as error:
        raise ConfigurationError(f"The table [{name}] of the configuration is wrong: {error}.") from None


def check_devices(driver: str, asked: Collection[str], served: str) -> None:
    """Checks that a driver is asked for nothing but the one device that it serves.

    Raises:
        ConfigurationError: It is.
    """
    unknown = sorted(set(asked) - {served})
    if unknown:
        text = f"The driver {driver} serves {served} only, not {', '.join(unknown)}; configure another driver for it."
        raise ConfigurationError(text, unknown=unknown)


def check_names(key: str, names: Mapping[str, str], what: str) -> None:
    """Checks a table of the names that bodies have elsewhere: each body needs one that no other has.

    Args:
        key: Of the table in the configuration.
        names: Body to name.
        what: Is named, such as ``topic``.

    Raises:
        ConfigurationError: There are no names, or two bodies share one.
    """
    if not names or len(set(names.values())) != len(names):
        raise ConfigurationError(f"{key} is {names}; give every body a {what} of its own.", names=names)
