"""Writes a blueprint as TOML for people: without defaults, short tables in one line."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import msgspec
import tomli_w

from pcmrs.fsm.blueprint import Blueprint, OperationSpec

__all__ = ["blueprint_toml"]

LONGEST_LINE = 120
HEADED = frozenset({"branches", "operations", "states", "parent", "sequence", "activities", "timers"})
HEADED_MEMBERS = frozenset({"branches", "operations", "outcomes"})

Path = tuple[str, ...]


def blueprint_toml(blueprint: Blueprint, *, comment: str = "") -> str:
    """Return the text of a file that reads back as `blueprint`, except for its `hash`.

    Args:
        blueprint: Expanded or not.
        comment: Lines for the head of the file.
    """
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    return "\n".join([*lines, *_table((), _without_defaults(msgspec.structs.replace(blueprint, hash="")))]) + "\n"


def _without_defaults(value: Any) -> Any:
    if isinstance(value, msgspec.Struct):
        fields = _fields(type(value))
        given = {field.encode_name: getattr(value, field.name) for field in fields if not _is_default(value, field)}
        return {key: _without_defaults(inner) for key, inner in given.items()}
    if isinstance(value, dict):
        return {key: _without_defaults(inner) for key, inner in value.items()}
    return [_without_defaults(inner) for inner in value] if isinstance(value, list) else value


@cache
def _fields(kind: type[msgspec.Struct]) -> tuple[msgspec.structs.FieldInfo, ...]:
    return msgspec.structs.fields(kind)


def _is_default(value: msgspec.Struct, field: msgspec.structs.FieldInfo) -> bool:
    made = field.default_factory
    default = field.default if made is msgspec.NODEFAULT else made()
    implied = value.implied if isinstance(value, OperationSpec) else {}
    return bool(getattr(value, field.name) == implied.get(field.name, default))


def _table(path: Path, table: dict[str, Any]) -> Iterator[str]:
    """The lines of a table without its header: first the values that fit a line, then the tables below it."""
    below = {key: value for key, value in table.items() if _has_header((*path, key), value)}
    yield from (_line(key, value) for key, value in table.items() if key not in below)
    for key, value in below.items():
        yield from _below((*path, key), value)


def _below(path: Path, value: Any) -> Iterator[str]:
    name = ".".join(_key(key) for key in path)
    if isinstance(value, list):
        for inner in value:
            yield from ("", f"[[{name}]]", *_table(path, inner))
        return
    if not value or not all(_has_header((*path, key), inner) for key, inner in value.items()):
        yield from ("", f"[{name}]")
    yield from _table(path, value)


def _has_header(path: Path, value: Any) -> bool:
    if isinstance(value, list):
        return bool(value) and all(isinstance(inner, dict) for inner in value)
    if not isinstance(value, dict):
        return False
    by_name = path[-1] in HEADED or HEADED_MEMBERS.intersection(path[-2:-1])
    return bool(by_name) or len(_line(path[-1], value)) > LONGEST_LINE


def _line(key: str, value: Any) -> str:
    return f"{_key(key)} = {_value(value)}"


def _value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        pairs = ", ".join(_line(key, inner) for key, inner in value.items())
        return f"{{ {pairs} }}" if pairs else "{}"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").rstrip("\n")


def _key(key: str) -> str:
    return tomli_w.dumps({key: 0}).removesuffix(" = 0\n")
