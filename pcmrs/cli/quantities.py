"""Results of commands as people read them: lengths in mm, angles in degrees, few digits."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees
from typing import Any, Final

UNITS: Final = {"mm": "mm", "deg": "°", "s": "s", "n": "N", "hz": "Hz", "percent": "%"}
"""Ending of a name, after an underscore, to the unit in which its value is given."""
LENGTHS: Final = frozenset(
    {"clearance", "confirm_offset", "depth", "distance", "distances", "length", "limit", "offset", "position"}
    | {"residual", "rms", "shift", "spread", "spreads", "standoff", "translation_error"}
    | {"tre", "travel"}
)
"""Names of results in m."""
FORCES: Final = frozenset({"asked", "force", "peak_force"})
"""Names of results in N."""
ANGLES: Final = frozenset({"rotation_error"})
"""Names of results in rad."""


def readable(result: Mapping[str, Any]) -> str:
    """Return the result of a command on one line.

    Args:
        result: Values by name; those without a unit in their name are in SI units.
    """
    return ", ".join(f"{name} {_text(name, value)}" for name, value in result.items())


def _text(name: str, value: Any) -> str:
    if isinstance(value, Mapping):
        if name in LENGTHS:  # by landmark
            return f"({', '.join(f'{key} {_text(name, each)}' for key, each in value.items())})"
        return f"({readable(value)})"
    if isinstance(value, list | tuple):
        if any(isinstance(each, Mapping | list | tuple) for each in value):
            return f"({len(value)})"
        scale, unit = _scaled(name)
        return f"({', '.join(_number(each, scale) for each in value)})" + (_spaced(unit) if unit else "")
    scale, unit = _scaled(name)
    counts = isinstance(value, float | int) and not isinstance(value, bool)
    return _number(value, scale) + (_spaced(unit) if unit and counts else "")


def _scaled(name: str) -> tuple[float, str]:
    """Return the factor and the unit in which a result is shown."""
    if name in LENGTHS:
        return 1000.0, "mm"
    if name in FORCES:
        return 1.0, "N"
    if name in ANGLES:
        return degrees(1.0), "°"
    return 1.0, UNITS.get(name.rpartition("_")[2], "")


def _spaced(unit: str) -> str:
    return unit if unit == "°" else f" {unit}"


def _number(value: Any, scale: float) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "not known"
    if not isinstance(value, float | int):
        return str(value)
    if isinstance(value, int) and scale == 1.0:
        return str(value)
    scaled = value * scale
    return f"{scaled:.2f}" if 0.01 <= abs(scaled) < 1000.0 or scaled == 0.0 else f"{scaled:.3g}"
