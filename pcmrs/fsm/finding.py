"""What is wrong with a workflow, said so that a person and a program can go and mend it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NoReturn

import msgspec

from pcmrs.errors import BlueprintError

Path = tuple[str, ...]
"""Keys from the root of a file; the elements of an array count from ``"0"``."""

Place = tuple[int, int]
"""Line and column in a file, from 1; 0 where there is none."""


class Finding(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One thing that is wrong.

    Attributes:
        code: Which kind, a key of `pcmrs.fsm.codes.CODES`.
        text: What, which value, which limit, and what to do.
        path: Keys from the root of the file to where it is wrong.
        file: The file as it was named.
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
        """Where, which kind and what, in one line whatever its texts contain."""
        place = (str(part) for part in (self.file, self.line, self.column) if part)
        return printable(": ".join(filter(None, (":".join(place), self.code, self.text))))

    def __str__(self) -> str:
        shown = f" (after {', '.join(self.commands) or 'the start'})" if self.commands is not None else ""
        return self.heading + printable(shown)


def printable(text: str) -> str:
    """A text in which no sign from a file can move the cursor, forge a line or hide what it says."""
    return "".join(sign if sign.isprintable() else sign.encode("unicode_escape").decode() for sign in text)


def summary(findings: Iterable[Finding]) -> str:
    """All findings, a line each."""
    return "\n".join(str(finding) for finding in findings)


def unread(origin: str, text: str) -> Finding:
    """What is to be said of a file that is not there or cannot be opened."""
    return Finding(code="cannot_be_read", text=text, file=origin)


def refuse(origin: str, code: str, text: str, place: Place = (1, 1), path: Path = ()) -> NoReturn:
    """Raise the `BlueprintError` that ends the reading of a file, with its one finding."""
    line, column = place
    finding = Finding(code=code, text=text, path=path, file=origin, line=line, column=column)
    raise BlueprintError(str(finding), findings=[finding])
