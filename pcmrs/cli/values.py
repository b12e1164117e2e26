"""Numbers and sizes on a command line."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
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


class Operation(click.ParamType[str]):
    """A name of the form ``branch.operation``."""

    name = "operation"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the name, or fail with a usage error."""
        if not _OPERATION.fullmatch(str(value)):
            self.fail(f"'{value}' is not an operation: write branch.operation, such as robot.connect.", param, ctx)
        return str(value)


class Arguments(click.ParamType[dict[str, Any]]):
    """A JSON object, or ``@FILE`` for one in a file."""

    name = "arguments"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> dict[str, Any]:
        """Return the object, or fail with a usage error."""
        if isinstance(value, dict):
            return value
        text = str(value)
        try:
            if text.startswith("@"):
                text = Path(text[1:]).read_text(encoding="utf-8")
            found = json.loads(text)
        except OSError as error:
            self.fail(f"{value[1:]} cannot be read: {error.strerror}.", param, ctx)
        except (ValueError, RecursionError) as error:
            self.fail(f"The arguments are not JSON: {error}.", param, ctx)
        if not isinstance(found, dict):
            self.fail('The arguments must be a JSON object, such as {"index": 0}.', param, ctx)
        return found


_UNITS = {"": 1, "b": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9}
_OPERATION = re.compile(r"[a-z][a-z0-9_]*\.[a-z][a-z0-9_]*")
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
