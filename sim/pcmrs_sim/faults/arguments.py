"""Arguments of faults, as words of a line or as data from the bus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pcmrs.errors import DeviceError


def switch(arguments: Mapping[str, Any], name: str) -> bool:
    """A truth value; true where it is left out.

    Raises:
        DeviceError: It is something else.
    """
    value = arguments.get(name, True)
    if isinstance(value, bool):
        return value
    raise DeviceError(f"The argument {name} is {value!r}, must be on or off.", argument=name, value=value)


def number(arguments: Mapping[str, Any], name: str, lowest: float, highest: float) -> float:
    """A number within a range.

    Raises:
        DeviceError: It is none, or outside.
    """
    value = arguments.get(name)
    if isinstance(value, int | float) and not isinstance(value, bool) and lowest <= value <= highest:
        return float(value)
    text = f"The argument {name} is {value!r}, must be a number from {lowest:g} to {highest:g}."
    raise DeviceError(text, argument=name, value=value, lowest=lowest, highest=highest)


def choice(arguments: Mapping[str, Any], name: str, known: Sequence[str]) -> Any:
    """One of the words in `known`.

    Raises:
        DeviceError: It is none of them.
    """
    value = arguments.get(name)
    if value in known:
        return value
    raise DeviceError(
        f"The argument {name} is {value!r}, must be one of {', '.join(known)}.", argument=name, value=value
    )
