"""Faults of a configuration: unknown keys and values that cannot be used, with what could be meant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import Any, Final

import msgspec
from msgspec import inspect

from pcmrs.fsm.files.toml import path_of_fault, text_of_fault
from pcmrs.fsm.finding import Path, hint

MOST: Final = 20
"""Number of faults that are reported at once."""


def faults_in(values: Mapping[str, Any], kind: type[Any]) -> Iterator[tuple[Path, str]]:
    """Yield path and text of each fault; a key with a fault is left out to find the next one.

    Args:
        values: Tables of a configuration.
        kind: Type of the whole configuration.
    """
    left = deepcopy(dict(values))
    for _ in range(MOST):
        try:
            msgspec.convert(left, kind)
        except msgspec.ValidationError as error:
            path = path_of_fault(left, kind, error)
            yield path, _text(left, kind, path, error)
            if not _leave_out(left, path):
                return
        else:
            return


def _text(values: Mapping[str, Any], kind: type[Any], path: Path, error: msgspec.ValidationError) -> str:
    name, text = ".".join(path), text_of_fault(error)
    if "unknown field" in text:
        known = [field.encode_name for field in _fields(inspect.type_info(kind), path[:-1])]
        return f"{name}: unknown key; {hint(path[-1], known)}"
    value = _value(values, path)
    if value is None or isinstance(value, dict):
        return f"{name}: {text[:1].lower()}{text[1:]}."
    unit, text = _unit(inspect.type_info(kind), path), f"{text[:1].lower()}{text[1:]}"
    start = f"{name} is {value!r}{unit and f' {unit}'}: {text}"
    if unit == "m" and isinstance(value, float | int) and value > 0:
        return f"{start}; did you mean {value / 1000:g} ({value:g} mm)?"
    return f"{start}."


def _value(values: Any, path: Path) -> Any:
    """Return the value at a path; None if there is none."""
    for key in path:
        if isinstance(values, Mapping):
            values = values.get(key)
        elif isinstance(values, list) and key.isdigit() and int(key) < len(values):
            values = values[int(key)]
        else:
            return None
    return values


def _leave_out(values: dict[str, Any], path: Path) -> bool:
    """Delete the nearest table's key on a path; return False if there is none."""
    table: Any = values
    for depth, key in enumerate(path):
        below = table.get(key)
        if depth == len(path) - 1 or not isinstance(below, dict):
            return table.pop(key, None) is not None
        table = below
    return False


def _fields(kind: inspect.Type, path: Path) -> tuple[inspect.Field, ...]:
    """Return the fields of the structure at a path."""
    found = _type_at(kind, path)
    return found.fields if isinstance(found, inspect.StructType) else ()


def _unit(kind: inspect.Type, path: Path) -> str:
    """Return the unit of the number at a path; empty if its type names none."""
    found = _type_at(kind, path)
    extra = found.extra if isinstance(found, inspect.Metadata) else None
    return str((extra or {}).get("unit", ""))


def _type_at(kind: inspect.Type | None, path: Path) -> inspect.Type | None:
    """Return the type of the value at a path, with its metadata; None where no single type is known."""
    for key in path:
        bare = kind.type if isinstance(kind, inspect.Metadata) else kind
        if isinstance(bare, inspect.UnionType):
            bare = next((each for each in bare.types if isinstance(each, inspect.StructType)), None)
        if isinstance(bare, inspect.StructType):
            kind = next((field.type for field in bare.fields if field.encode_name == key), None)
        elif isinstance(bare, inspect.DictType):
            kind = bare.value_type
        elif isinstance(bare, inspect.ListType | inspect.VarTupleType):
            kind = bare.item_type
        else:
            return None
    if isinstance(kind, inspect.UnionType):
        return next((each for each in kind.types if isinstance(each, inspect.StructType)), kind)
    return kind
