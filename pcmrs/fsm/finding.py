"""Findings: what is wrong with a workflow, where, and how to fix it, for people and for programs."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import NoReturn

import msgspec

from pcmrs.errors import BlueprintError
from pcmrs.visible import visible

Path = tuple[str, ...]
"""Keys from the root of a file; the elements of an array count from ``"0"``."""

Place = tuple[int, int]
"""Line and column in a file, from 1; 0 where there is none."""


class Finding(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One thing that is wrong.

    Attributes:
        code: Kind of finding, a key of `pcmrs.fsm._codes.CODES`.
        text: What is wrong, the value, the limit, and what to do.
        path: Keys from the root of the file to the fault.
        file: Name of the file, as the caller gave it.
        line: In the file, from 1; 0 where it is not known.
        column: In the line, from 1; 0 where it is not known.
        commands: A shortest sequence of commands that shows it, ``branch.operation`` or
            ``branch.operation:outcome`` each, from the initial states; None where commands do not show it.
    """

    code: str
    text: str
    path: Path = ()
    file: str = ""
    line: int = 0
    column: int = 0
    commands: tuple[str, ...] | None = None

    @property
    def heading(self) -> str:
        """Location, code and text in one line, whatever characters the text contains."""
        place = (str(part) for part in (self.file, self.line, self.column) if part)
        return visible(": ".join(filter(None, (":".join(place), self.code, self.text))))

    def __str__(self) -> str:
        shown = f" (after {', '.join(self.commands) or 'the start'})" if self.commands is not None else ""
        return self.heading + visible(shown)


def summary(findings: Iterable[Finding]) -> str:
    """Return all findings, a line each."""
    return "\n".join(str(finding) for finding in findings)


def hint(word: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown word: the closest known word, or all of them.

    Args:
        word: The unknown word.
        known: All words that could be meant.
    """
    words = list(known)
    close = get_close_matches(word, words, n=1, cutoff=0.75)
    return f"did you mean {close[0]!r}?" if close else f"choose from {', '.join(words)}."


def unreadable_file(origin: str, text: str) -> Finding:
    """Return the finding on a file that does not exist or cannot be opened.

    Args:
        origin: Name of the file in findings.
        text: Reason.
    """
    return Finding(code="cannot_be_read", text=text, file=origin)


def refuse(origin: str, code: str, text: str, place: Place = (1, 1), path: Path = ()) -> NoReturn:
    """Raise the `BlueprintError` that ends the reading of a file, with its one finding.

    Args:
        origin: Name of the file in findings.
        code: Key of `pcmrs.fsm._codes.CODES`.
        text: What is wrong, and what to do.
        place: Line and column in the file.
        path: Keys from the root of the file to the fault.

    Raises:
        BlueprintError: Always.
    """
    line, column = place
    finding = Finding(code=code, text=text, path=path, file=origin, line=line, column=column)
    raise BlueprintError(str(finding), findings=[finding])
