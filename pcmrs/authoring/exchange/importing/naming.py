"""Names of a chart as names of a blueprint; what cannot be one is a finding, not a guess."""

from __future__ import annotations

import keyword

from pcmrs.authoring.exchange import plain
from pcmrs.authoring.exchange.importing.reading import Findings
from pcmrs.fsm.classes import RESERVED
from pcmrs.fsm.finding import Place
from pcmrs.fsm.rules.names import ENDINGS, NAME, STATE_NAME


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
