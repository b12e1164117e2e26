"""One state in a chart: its box, and the ports where lines end at its left and right edge.

Every line has its own port, as high as its caption, so that neither lines nor captions meet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pcmrs.authoring.chart._text import clean, cut, flow, mono_width, sans_width, widest, wrap

NAME, MEANING, LABEL = 13, 11, 10
"""Font sizes in px: names of states, their meanings, captions of lines."""

LINE = 12
"""Height of a line of text in px."""

CAPTION_COLUMNS, MEANING_COLUMNS, MEANING_LINES, NAME_COLUMNS = 23, 24, 3, 32

_BARE, _AROUND, _MARGIN = 9.0, 8.0, 12.0


@dataclass(slots=True)
class Port:
    """End of a line at a box, with the caption above it.

    Attributes:
        line: Identity of the line, unique in the chart.
        caption: Lines of text; empty for a line that only leaves.
        y: Height of the line in the chart, in px, once it is placed.
    """

    line: object
    caption: list[str]
    y: float = 0.0

    @property
    def height(self) -> float:
        """Room it takes along the edge of the box, in px."""
        return len(self.caption) * LINE + (_AROUND if self.caption else _BARE)

    @property
    def width(self) -> float:
        """Width of its caption in px."""
        return widest(mono_width(line, LABEL) for line in self.caption)


@dataclass(slots=True)
class StateRow:
    """One state.

    Attributes:
        state: Its name.
        meaning: Lines of its meaning.
        inner: Lines about its activity and timers.
        loops: Lines with the operations that keep it.
        left: Ports at the left edge, from the top.
        right: Ports at the right edge, from the top.
        y: Upper edge of its box in px.
        height: Height of its box in px.
    """

    state: str
    meaning: list[str]
    inner: list[str]
    loops: list[str]
    left: list[Port] = field(default_factory=list)
    right: list[Port] = field(default_factory=list)
    y: float = 0.0
    height: float = 0.0

    @property
    def bottom(self) -> float:
        """Lower edge of its box in px."""
        return self.y + self.height

    @property
    def width(self) -> float:
        """Width that its texts need, in px."""
        name = mono_width(self.state, NAME)
        meaning = widest(sans_width(line, MEANING) for line in self.meaning)
        inner = widest(mono_width(line, LABEL) for line in self.inner)
        return max(name, meaning, inner, 14 + widest(mono_width(line, LABEL) for line in self.loops)) + 2 * _MARGIN

    @property
    def text_height(self) -> float:
        """Height that its texts need, in px."""
        lines = len(self.meaning) + len(self.inner) + len(self.loops)
        return NAME + LINE * lines + 3 * bool(self.loops)

    def place(self, y: float) -> None:
        """Place the box at `y`, as high as its texts and ports need, and the ports along its edges."""
        self.y = y
        self.height = max(self.text_height + 14, *(_total(ports) + 4 for ports in (self.left, self.right)))
        for ports in (self.left, self.right):
            top = y + (self.height - _total(ports)) / 2
            for port in ports:
                top += port.height
                port.y = top - _BARE / 2


def row(state: str, meaning: str, inner: Sequence[str], loops: Sequence[str]) -> StateRow:
    """Return a state without ports.

    Args:
        state: Its name.
        meaning: Its meaning.
        inner: The lines about its activity and timers.
        loops: The operations that keep it.
    """
    lines = wrap(clean(meaning), MEANING_COLUMNS, MEANING_LINES)
    inside = [cut(clean(line), NAME_COLUMNS) for line in inner]
    return StateRow(cut(clean(state), NAME_COLUMNS), lines, inside, flow(loops, CAPTION_COLUMNS))


def _total(ports: Sequence[Port]) -> float:
    return sum(port.height for port in ports)
