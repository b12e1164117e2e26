"""What all readers of foreign files share: a limit, and how they say what is wrong.

The text on an arrow of a drawing: which events trigger it.
"""

from __future__ import annotations

import re

from pcmrs.fsm.files.bounded import text_of
from pcmrs.fsm.finding import Finding, Place

MAX_DEPTH = 64
"""Deepest nesting of elements or states that is read."""


class Findings(list[Finding]):
    """What is wrong with one file.

    Args:
        origin: How findings call the file.
    """

    def __init__(self, origin: str) -> None:
        super().__init__()
        self.origin = origin
        self._said: set[Finding] = set()

    def say(self, code: str, text: str, place: Place) -> None:
        """Add a finding; the same one again only once."""
        line, column = place
        finding = Finding(code=code, text=text, file=self.origin, line=line, column=column)
        if finding not in self._said:
            self._said.add(finding)
            self.append(finding)


def read_text(raw: bytes, origin: str) -> str:
    """The text of a file, without the mark that some editors begin it with; see `text_of`."""
    return text_of(raw, origin).removeprefix("\ufeff")


NO_EVENTS = "An arrow needs the events that trigger it, with commas between, without conditions and actions"
"""What to say where there are none."""

_REMARK = re.compile(r" \([^()]*\)$")


def events_of(label: str) -> list[str]:
    """The events a label names; empty where it names none, or holds a condition ``[…]`` or an action ``/ …``.

    A remark in round brackets at the end of an event is left out.
    """
    if any(sign in label for sign in "[]/"):
        return []
    parts = (_REMARK.sub("", " ".join(part.split())) for part in label.split(","))
    return list(dict.fromkeys(part for part in parts if part))
