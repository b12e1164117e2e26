"""Positions of the keys in a TOML text, which the parser of the standard library does not give.

The scanner reads TOML 1.0. It checks only the depth: it stops at text that is not TOML, and `tomllib` says
what is wrong.

It also accepts the old names of renamed keys of a blueprint, with a warning.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple, NoReturn

from pcmrs.fsm.finding import Finding, Path

RENAMED = {"acts": "affects_patient", "halts": "blocked_when_latched"}
"""Old name of an operation's key to its present name."""

OF_A_SEQUENCE = ("perform", "skip", "repeat", "abandon")


def rename_keys(table: dict[str, Any]) -> list[Finding]:
    """Give the keys of a file's operations their present names, in place, and return a warning for each.

    If a key is given under both names, both stay: the old name is then unknown, and the file is refused.
    """
    warnings: list[Finding] = []
    for path, operation in _operations(table):
        for old, new in RENAMED.items():
            if old in operation and new not in operation:
                operation[new] = operation.pop(old)
                text = f"`{old}` is now called `{new}`: rename it."
                warnings.append(Finding(code="old_key", text=text, path=(*path, old)))
    return warnings


def _operations(table: dict[str, Any]) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Return everything in an unchecked file that may be an operation."""
    for name, branch in _tables(table.get("branches")):
        written = ((("operations", key), each) for key, each in _tables(branch.get("operations")))
        made = ((("sequence", key), each) for key, each in _tables(branch.get("sequence")) if key in OF_A_SEQUENCE)
        for below, operation in (*written, *made):
            yield ("branches", name, *below), operation


def _tables(value: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    if isinstance(value, dict):
        yield from ((key, each) for key, each in value.items() if isinstance(each, dict))


MAX_DEPTH = 64
"""Largest depth of nested arrays, inline tables and dotted keys."""

_PART = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
_KEY = re.compile(rf"{_PART}(?:[ \t]*\.[ \t]*{_PART})*")
_PARTS = re.compile(_PART)
_SPACE = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_OPENING = re.compile(r"\[{1,2}[ \t]*")
_CLOSING = re.compile(r"[ \t]*\]{1,2}")
_EQUALS = re.compile(r"[ \t]*=[ \t]*")
_STRING = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}' r"|'''.*?'{3,5}" r'|"(?:[^"\\\n]|\\.)*"' r"|'[^'\n]*'",
    re.DOTALL,
)
_SCALAR = re.compile(r"[^\s,\]}#][^,\]}#\n]*")


class TomlKey(NamedTuple):
    """A key of a table, or an element of an array.

    Attributes:
        at: Offset of its first character.
        path: Keys and indices that lead to it.
        above: The part of the path that is written elsewhere in the text.
    """

    at: int
    path: Path
    above: Path


class DepthError(Exception):
    """Keys or values are nested over `MAX_DEPTH` deep.

    Attributes:
        at: Offset of the first one that is too deep.
    """

    def __init__(self, at: int) -> None:
        super().__init__(at)
        self.at = at


def keys_in(text: str) -> list[TomlKey]:
    """Return all keys and elements in the order of the text, up to the first place that is not TOML.

    Raises:
        DepthError: They are nested too deep.
    """
    scanner = _Scanner(text)
    with suppress(_MalformedError):
        scanner.scan()
    return scanner.found


class _MalformedError(Exception):
    """The text is not TOML; `tomllib` says why."""


class _Scanner:
    def __init__(self, text: str) -> None:
        self.found: list[TomlKey] = []
        self._text = text
        self._at = 0
        self._lengths: dict[Path, int] = {}  # of arrays of tables

    def scan(self) -> None:
        table: Path = ()
        while True:
            self._skip(_SPACE)
            if self._at == len(self._text):
                return
            if self._peek() == "[":
                opening = self._take(_OPENING)
                start, keys = self._key(0)
                self._take(_CLOSING)
                table = self._resolved(keys, new=opening.startswith("[["))
                self.found.append(TomlKey(start, table, ()))
            else:
                self._pair(table, 0)

    def _pair(self, above: Path, depth: int) -> None:
        start, keys = self._key(depth)
        path = (*above, *keys)
        self.found.append(TomlKey(start, path, above))
        self._take(_EQUALS)
        self._value(path, depth + len(keys) + 1)

    def _key(self, depth: int) -> tuple[int, Path]:
        start = self._at
        text = self._take(_KEY)
        if depth + sum(1 for _ in _PARTS.finditer(text)) > MAX_DEPTH:
            raise DepthError(start)
        return start, _keys(text)

    def _value(self, path: Path, depth: int) -> None:
        first = self._peek()
        if first in "[{" and depth >= MAX_DEPTH:
            raise DepthError(self._at)
        if first == "[":
            for index in self._items("]"):
                element = (*path, str(index))
                self.found.append(TomlKey(self._at, element, path))
                self._value(element, depth + 1)
        elif first == "{":
            for _ in self._items("}"):
                self._pair(path, depth)
        else:
            self._take(_STRING if first in "\"'" else _SCALAR)

    def _items(self, end: str) -> Iterator[int]:
        """Stop at each item between brackets, and finally behind the closing one."""
        self._at += 1
        index = 0
        while True:
            self._skip(_SPACE)
            if self._peek() == end:
                self._at += 1
                return
            yield index
            index += 1
            self._skip(_SPACE)
            if self._peek() == ",":
                self._at += 1
            elif self._peek() != end:
                _malformed()

    def _resolved(self, keys: Path, *, new: bool) -> Path:
        """Return the path of a header, with the number of the newest element after each array of tables."""
        path: Path = ()
        for key in keys[:-1]:
            path = (*path, key)
            if path in self._lengths:
                path = (*path, str(self._lengths[path] - 1))
        path = (*path, keys[-1])
        if not new:
            return path
        self._lengths[path] = self._lengths.get(path, 0) + 1
        return (*path, str(self._lengths[path] - 1))

    def _peek(self) -> str:
        if self._at == len(self._text):
            _malformed()
        return self._text[self._at]

    def _take(self, pattern: re.Pattern[str]) -> str:
        match = pattern.match(self._text, self._at)
        if match is None:
            _malformed()
        self._at = match.end()
        return match[0]

    def _skip(self, pattern: re.Pattern[str]) -> None:
        match = pattern.match(self._text, self._at)
        self._at = match.end() if match else self._at


def _malformed() -> NoReturn:
    raise _MalformedError


def _keys(text: str) -> Path:
    if '"' not in text and "'" not in text:
        return tuple(part.strip() for part in text.split("."))
    try:
        return tuple(_flat(tomllib.loads(f"{text} = 0")))
    except ValueError:  # an escape that TOML does not know
        _malformed()


def _flat(table: dict[str, Any]) -> Iterator[str]:
    for key, inner in table.items():
        yield key
        if isinstance(inner, dict):
            yield from _flat(inner)
