"""Typed configuration: defaults in code, overridden by a TOML file, overridden by single values."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from pcmrs.errors import ConfigurationError

S = TypeVar("S", bound=msgspec.Struct)
Where = Callable[[tuple[str, ...]], str]
"""Returns where the key at a path was set, such as ``cell.toml:3:1``; empty if unknown."""


def as_config(
    kind: type[S], values: Mapping[str, Any], origin: str = "The configuration", where: Where | None = None
) -> S:
    """Convert values to a configuration.

    Args:
        kind: Type of the whole configuration, with the defaults.
        values: Values that differ from the defaults.
        origin: Origin of the values, for messages.
        where: Locates the keys; None if no file has them.

    Raises:
        ConfigurationError: Keys are unknown, or values have the wrong type or range or are not finite numbers; the text
            has a line for each, with what could be meant.
    """
    try:
        _check_finite(values, "")
        return msgspec.convert(values, kind)
    except msgspec.ValidationError:
        from pcmrs.config._faults import faults_in  # not needed for a right configuration

        found = [(where(path) if where else "", text) for path, text in faults_in(values, kind)]
        lines = [f"{place}: {text}" if place else text for place, text in found]
        text = f" {lines[0]}" if len(lines) == 1 else "\n".join(["", *lines])
        raise ConfigurationError(f"{origin} is wrong:{text}") from None
    except ValueError as error:
        raise ConfigurationError(f"{origin} is wrong: {error}.") from None


def merge_tables(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return two tables merged, with their inner tables.

    Args:
        base: First table.
        over: Second table; its values replace those of the first.
    """
    both = dict(base)
    for key, value in over.items():
        below = both.get(key)
        both[key] = merge_tables(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return both


def set_values(values: dict[str, Any], overrides: Sequence[str]) -> None:
    """Set single values.

    Args:
        values: Configuration as plain data, which is changed.
        overrides: Settings, ``key=value`` each, such as ``robot.model=iiwa7``; the value is TOML, or plain text.

    Raises:
        ConfigurationError: A setting does not have this form, or a key in its path is not a table.
    """
    for override in overrides:
        _set(values, override)


def read_file(file: Path) -> dict[str, Any]:
    """Read the tables of a TOML file. Raises `ConfigurationError`."""
    try:
        return tomllib.loads(file.read_text())
    except OSError as error:
        raise ConfigurationError(f"{file} cannot be read: {error.strerror}.", file=str(file)) from None
    except (ValueError, RecursionError) as error:  # more than TOMLDecodeError: a number may have too many digits
        raise ConfigurationError(f"{file} is not TOML: {error}.", file=str(file)) from None


def _set(values: dict[str, Any], override: str) -> None:
    path, equals, text = override.partition("=")
    if not equals or not all(path.split(".")):
        text = f"{override!r} is not of the form key=value, such as robot.model=iiwa7."
        raise ConfigurationError(text, override=override)
    *tables, key = path.split(".")
    for table in tables:
        inner = values.setdefault(table, {})
        if not isinstance(inner, dict):
            raise ConfigurationError(f"{path}: {table} is a value, not a table.", override=override)
        values = inner
    values[key] = _value(text)


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text


def _check_finite(value: Any, path: str) -> None:
    """Refuse nan and inf, which TOML permits: no value would ever exceed such a limit."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{path[1:]} is {value}; every number must be finite")
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        _check_finite(item, f"{path}.{key}")


def as_table(config: msgspec.Struct) -> Mapping[str, Any]:
    """Return a configuration as plain data, as files and drivers read it."""
    table: dict[str, Any] = msgspec.to_builtins(config)
    return table
