"""What all readers of foreign files share: a limit, and how they say what is wrong.

The text on an arrow of a drawing: which events trigger it.

Names of a chart as names of a blueprint; what cannot be one is a finding, not a guess.
"""

from __future__ import annotations

import keyword
import re

from pcmrs.authoring.exchange import plain
from pcmrs.fsm.classes import RESERVED
from pcmrs.fsm.files.toml import decode_text
from pcmrs.fsm.finding import Finding, Place
from pcmrs.fsm.rules.names import ENDINGS, NAME, STATE_NAME

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
    """The text of a file, without the mark that some editors begin it with; see `decode_text`."""
    return decode_text(raw, origin).removeprefix("\ufeff")


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


class Names:
    """Names of one kind that must differ: the branches, or the states or operations of one branch.

    Args:
        what: What they name, for findings.
        findings: Where to say what cannot be named.
        states: Whether they may begin with a digit and be words of Python, as states may.
    """

    def __init__(self, what: str, findings: Findings, *, states: bool = False) -> None:
        self._what = what
        self._findings = findings
        self._states = states
        self._taken: dict[str, str] = {}

    def make(self, raw: str, place: Place, prefix: str = "") -> str:
        """The name for `raw`: in lower case with ``_`` for what is neither letter nor digit, without the prefix."""
        return self.take(plain(raw, prefix), raw, place)

    def take(self, name: str, raw: str, place: Place) -> str:
        """Take a name for something called `raw`; says what is wrong with it."""
        if not (STATE_NAME if self._states else NAME).fullmatch(name):
            text = f"{raw[:70]!r} gives {name[:70]!r}, no name for {self._what}: begin with a letter, and be short."
            self._findings.say("bad_name", text, place)
        elif not self._states and (keyword.iskeyword(name) or name in RESERVED | ENDINGS):
            text = f"{raw!r} cannot be the name of {self._what}: Python or PCMRS use {name!r}. Rename it."
            self._findings.say("reserved_name", text, place)
        elif name in self._taken:
            text = f"{raw!r} and {self._taken[name]!r} would both be {name!r} among {self._what}: rename one."
            self._findings.say("name_collision", text, place)
        self._taken.setdefault(name, raw)
        return name
