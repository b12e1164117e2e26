"""Reads TOML from any author: bounded in size and depth, with the location of every fault."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Any, TypeVar

import msgspec

from pcmrs.fsm.files._keys import MAX_DEPTH, DepthError, keys_in
from pcmrs.fsm.files.places import Places
from pcmrs.fsm.finding import Path, Place, refuse

MAX_BYTES = 256 * 1024


def read_bounded(path: FilePath) -> bytes:
    """Return the bytes of a file; of a huge file, only so many that `check_size` refuses it.

    Raises:
        OSError: It cannot be read.
    """
    with path.open("rb") as stream:
        return stream.read(MAX_BYTES + 1)


def check_size(raw: bytes, origin: str) -> None:
    """Refuse a file that is too long.

    Args:
        raw: The file.
        origin: Its name in findings.

    Raises:
        BlueprintError: The file is longer than `MAX_BYTES`; `findings` says so.
    """
    if len(raw) > MAX_BYTES:
        refuse(origin, "too_large", f"The file has {len(raw)} bytes; the limit is {MAX_BYTES}. Split the workflow.")


def decode_text(raw: bytes, origin: str) -> str:
    """Return the text of a file.

    Args:
        raw: The file.
        origin: Its name in findings.

    Raises:
        BlueprintError: It is too large or not UTF-8; `findings` has where.
    """
    check_size(raw, origin)
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        before = raw[: error.start].decode()
        place = before.count("\n") + 1, len(before.rpartition("\n")[2]) + 1
        text = f"Byte 0x{raw[error.start]:02x} is not UTF-8: save the file as UTF-8."
        refuse(origin, "not_utf8", text, place)


T = TypeVar("T")

_PLACE = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
_UNKNOWN_KEY = re.compile(r"unknown field `([^`]+)`")
_PATH = re.compile(r" - at (?:`[^`]*` in )?`\$?([^`]*)`$")


def read_toml(raw: bytes, origin: str) -> tuple[dict[str, Any], Places]:
    """Return the table in a file, and the locations of its keys.

    Args:
        raw: The file.
        origin: Its name in findings.

    Raises:
        BlueprintError: It is too large or too deep, or not TOML; `findings` has where.
    """
    text = decode_text(raw, origin)
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
        refuse(origin, "not_toml", f"This is not TOML: {_parser_message(error)}.", _place(error, text))


def convert(table: Mapping[str, Any], kind: type[T], places: Places) -> T:
    """Return the table as a typed structure.

    Args:
        table: Table of a TOML file.
        kind: Type to convert it to.
        places: Locations of the keys in the file.

    Raises:
        BlueprintError: A key is unknown or missing, or a value has the wrong type; `findings` has where.
    """
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        path = path_of_fault(table, kind, error)
        where = ".".join(path) or "the file"
        origin, line, column = places.of(path)
        refuse(origin, "bad_value", f"In {where}: {text_of_fault(error)}.", (line, column), path)


def _parser_message(error: ValueError) -> str:
    if not isinstance(error, tomllib.TOMLDecodeError):
        return f"a number has over {sys.get_int_max_str_digits()} digits"
    return _PLACE.sub("", str(error))


def _place(error: ValueError, text: str) -> Place:
    """Return the place that the parser names, or the first number that is too long, or else the end of the file."""
    if (place := _PLACE.search(str(error))) and place[1]:
        return int(place[1]), int(place[2])
    digits = None if place else re.search(rf"[\d_]{{{sys.get_int_max_str_digits()},}}", text)
    return _line_and_column(text, digits.start() if digits else len(text))


def _line_and_column(text: str, at: int) -> Place:
    before = text[:at]
    return before.count("\n") + 1, len(before.rpartition("\n")[2]) + 1


def text_of_fault(error: msgspec.ValidationError) -> str:
    """Return the text of a fault without its path."""
    return _PATH.sub("", str(error))


def path_of_fault(table: Mapping[str, Any], kind: type[Any], error: msgspec.ValidationError) -> Path:
    """Return the path of a fault. msgspec does not name the keys of dictionaries, so each is tried alone.

    Args:
        table: Table that could not be converted.
        kind: Type that it was to be converted to.
        error: Error of the conversion.
    """
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
    """Return the table with nothing but `key` at `path`."""
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
