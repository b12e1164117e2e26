"""Keys of a blueprint that were renamed: the old names are accepted, with a warning."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pcmrs.fsm.finding import Finding, Path

RENAMED = {"acts": "affects_patient", "halts": "blocked_when_latched"}
"""Old name of an operation's key to its present one."""

OF_A_SEQUENCE = ("perform", "skip", "repeat", "abandon")


def rename_keys(table: dict[str, Any]) -> list[Finding]:
    """Gives the keys of a file's operations their present names, in place; returns a warning for each.

    Where a key is there under both names, both stay: the old one is then unknown, and the file is refused.
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
    """What may be an operation in a file that nobody has checked yet."""
    for name, branch in _tables(table.get("branches")):
        written = ((("operations", key), each) for key, each in _tables(branch.get("operations")))
        made = ((("sequence", key), each) for key, each in _tables(branch.get("sequence")) if key in OF_A_SEQUENCE)
        for below, operation in (*written, *made):
            yield ("branches", name, *below), operation


def _tables(value: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    if isinstance(value, dict):
        yield from ((key, each) for key, each in value.items() if isinstance(each, dict))
