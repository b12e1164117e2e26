"""Reads TOML that anybody may have written: bounded in size and depth, with the place of every fault."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from pcmrs.fsm.files.bounded import text_of
from pcmrs.fsm.files.keys import MAX_DEPTH, DepthError, keys_in
from pcmrs.fsm.files.places import Places
from pcmrs.fsm.finding import Path, Place, refuse

T = TypeVar("T")

_PLACE = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
_UNKNOWN_KEY = re.compile(r"unknown field `([^`]+)`")
_PATH = re.compile(r" - at (?:`[^`]*` in )?`\$?([^`]*)`$")


def read_toml(raw: bytes, origin: str) -> tuple[dict[str, Any], Places]:
    """The table in a file, and where its keys are.

    Raises:
        BlueprintError: It is too large or too deep, or not TOML; `findings` has where.
    """
    text = text_of(raw, origin)
    try:
        keys = keys_in(text)
        return tomllib.loads(text), Places(text, keys, origin)
    except DepthError as error:
        refuse(
            origin, "too_deep", f"Keys or values are nested over {MAX_DEPTH} deep.", _line_and_column(text, error.at)
        )
    except RecursionError:
        refuse(origin, "too_deep", f"Values are nested over {MAX_DEPTH} deep.")
    except ValueError as error:  # more than TOMLDecodeError: a number may have too many digits
        refuse(origin, "not_toml", f"This is not TOML: {_said(error)}.", _place(error, text))


def convert(table: Mapping[str, Any], kind: type[T], places: Places) -> T:
    """The table as a typed structure.

    Raises:
        BlueprintError: A key is unknown or missing, or a value has the wrong type; `findings` has where.
    """
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        path = _narrowed(table, kind, error)
        where = ".".join(path) or "the file"
        origin, line, column = places.of(path)
        refuse(origin, "bad_value", f"In {where}: {_PATH.sub('', str(error))}.", (line, column), path)


def _said(error: ValueError) -> str:
    if not isinstance(error, tomllib.TOMLDecodeError):
        return f"a number has over {sys.get_int_max_str_digits()} digits"
    return _PLACE.sub("", str(error))


def _place(error: ValueError, text: str) -> Place:
    """Where the parser says it is, or the first number that is too long, or else the end of the file."""
    if (place := _PLACE.search(str(error))) and place[1]:
        return int(place[1]), int(place[2])
    digits = None if place else re.search(rf"[\d_]{{{sys.get_int_max_str_digits()},}}", text)
    return _line_and_column(text, digits.start() if digits else len(text))


def _line_and_column(text: str, at: int) -> Place:
    before = text[:at]
    return before.count("\n") + 1, len(before.rpartition("\n")[2]) + 1


def _narrowed(table: Mapping[str, Any], kind: type[Any], error: msgspec.ValidationError) -> Path:
    """The path of a fault; msgspec does not name the keys of dictionaries, so each is tried alone."""
    path: Path = ()
    found = _PATH.search(str(error))
    for step in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", found[1] if found else ""):
        key = step[0] or step[1]
        if key == "...":
            inner = _at(table, path)
            key = next((k for k in inner if _is_at_fault(_only(table, path, k), kind, str(error))), key)
        path = (*path, key)
    unknown = _UNKNOWN_KEY.search(str(error))
    return (*path, unknown[1]) if unknown else path


def _at(table: Mapping[str, Any], path: Path) -> Any:
    value: Any = table
    for key in path:
        value = value[int(key)] if isinstance(value, list) else value[key]
    return value


def _only(table: Any, path: Path, key: str) -> Any:
    """The table with nothing but `key` at `path`."""
    if not path:
        return {key: table[key]}
    if isinstance(table, list):
        index = int(path[0])
        return [*table[:index], _only(table[index], path[1:], key), *table[index + 1 :]]
    return {**table, path[0]: _only(table[path[0]], path[1:], key)}


def _is_at_fault(table: Any, kind: type[Any], text: str) -> bool:
    try:
        msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        return str(error) == text
    return False
