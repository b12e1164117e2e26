"""Shared parts of all readers of charts: limits, findings, names, and the events on an arrow."""

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
    """Findings on one file.

    Args:
        origin: Name of the file in findings.
    """

    def __init__(self, origin: str) -> None:
        super().__init__()
        self.origin = origin
        self._said: set[Finding] = set()

    def add(self, code: str, text: str, place: Place) -> None:
        """Add a finding, unless it is there already.

        Args:
            code: Key of `pcmrs.fsm._codes.CODES`.
            text: What is wrong, and what to do.
            place: Line and column in the file.
        """
        line, column = place
        finding = Finding(code=code, text=text, file=self.origin, line=line, column=column)
        if finding not in self._said:
            self._said.add(finding)
            self.append(finding)


def read_text(raw: bytes, origin: str) -> str:
    """Return the text of a file, without the byte order mark that some editors begin it with; see `decode_text`.

    Args:
        raw: The file.
        origin: Name of the file in findings.
    """
    return decode_text(raw, origin).removeprefix("\ufeff")


NO_EVENTS = "An arrow needs the events that trigger it, with commas between, without conditions and actions"
"""Finding on an arrow without events."""

_REMARK = re.compile(r" \([^()]*\)$")


def events_of(label: str) -> list[str]:
    """Return the events that a label names; empty if it names none, or has a condition ``[…]`` or an action ``/ …``.

    A remark in round brackets at the end of an event is ignored.
    """
    if any(sign in label for sign in "[]/"):
        return []
    parts = (_REMARK.sub("", " ".join(part.split())) for part in label.split(","))
    return list(dict.fromkeys(part for part in parts if part))


class Names:
    """Names of one kind that must differ: the branches, or the states or operations of one branch.

    Args:
        what: Kind of what they name, for findings.
        findings: Collects names that cannot be used.
        states: They name states, which may begin with a digit and be words of Python.
    """

    def __init__(self, what: str, findings: Findings, *, states: bool = False) -> None:
        self._what = what
        self._findings = findings
        self._states = states
        self._taken: dict[str, str] = {}

    def make(self, raw: str, place: Place, prefix: str = "") -> str:
        """Return the name for `raw`: in lower case, with ``_`` for anything that is neither letter nor digit.

        Args:
            raw: Name in the chart.
            place: Its place in the file.
            prefix: Left out if the name begins with it.
        """
        return self.take(plain(raw, prefix), raw, place)

    def take(self, name: str, raw: str, place: Place) -> str:
        """Reserve a name, and report it if it cannot be used.

        Args:
            name: The name.
            raw: Name in the chart.
            place: Its place in the file.
        """
        if not (STATE_NAME if self._states else NAME).fullmatch(name):
            text = f"{raw[:70]!r} gives {name[:70]!r}, no name for {self._what}: use a short one with a letter first."
            self._findings.add("bad_name", text, place)
        elif not self._states and (keyword.iskeyword(name) or name in RESERVED | ENDINGS):
            text = f"{raw!r} cannot be the name of {self._what}: Python or PCMRS uses {name!r}. Rename it."
            self._findings.add("reserved_name", text, place)
        elif name in self._taken:
            text = f"{raw!r} and {self._taken[name]!r} would both be {name!r} among {self._what}: rename one."
            self._findings.add("name_collision", text, place)
        self._taken.setdefault(name, raw)
        return name
