"""Numbers and sizes on a command line."""

from __future__ import annotations

import math
import re
from typing import Any

import click


class Finite(click.FloatRange):
    """A finite number within a range; nan would pass any range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number, or fail with a usage error."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not finite; give a number.", param, ctx)
        return number


POSITIVE = Finite(0.0, min_open=True)


_UNITS = {"": 1, "b": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9}
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([a-z]*)")


class Size(click.ParamType[float]):
    """A number of bytes, such as 512MB or 4GB (1 MB is 1e6 bytes)."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number of bytes, or fail with a usage error."""
        if isinstance(value, float):
            return value
        found = _SIZE.fullmatch(str(value).strip().lower())
        if found is None or found[2] not in _UNITS or float(found[1]) <= 0.0:
            self.fail(f"{value} is not a size, such as 512MB or 4GB.", param, ctx)
        return float(found[1]) * _UNITS[found[2]]
