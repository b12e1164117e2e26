"""The legend of a chart."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from xml.etree.ElementTree import Element

from pcmrs.authoring.chart._arrows import Kind
from pcmrs.authoring.chart._canvas import HEAD, INK, box, diamond, group, head, line, loop, point, sans, start
from pcmrs.authoring.chart._text import sans_width

LINE_HEIGHT = 20.0
"""Distance of the legend's lines in px."""

_SIZE, _SAMPLE, _GAP = 11, 38.0, 24.0

_KINDS: dict[Kind, str] = {
    "transition": "operation: outcome",
    "failure": "failed, or its end unknown",
    "signal": "Rule 2: a change calls the parent's operation",
    "call": "Rule 3: entering the state re-initiates the child",
    "revocation": "a change revokes",
}

Sample = Callable[[Element, float, float], None]


def draw_legend(parent: Element, x: float, y: float, width: float) -> float:
    """Draw the legend and return its lower edge, in px.

    Args:
        parent: Element to append it to.
        x: Left edge, in px.
        y: Upper edge, in px.
        width: Width of its lines, in px.
    """
    into = group(parent, "legend")
    at = x
    for words, sample in _samples().items():
        needed = _SAMPLE + 8 + sans_width(words, _SIZE) + _GAP
        if at > x and at + needed > x + width:
            at, y = x, y + LINE_HEIGHT
        sample(into, at, y + LINE_HEIGHT / 2)
        sans(into, at + _SAMPLE + 8, y + LINE_HEIGHT / 2 + 4, words, _SIZE)
        at += needed
    return y + LINE_HEIGHT


def least_width() -> float:
    """Return the smallest width of the legend, in px."""
    return max(_SAMPLE + 8 + sans_width(words, _SIZE) + _GAP for words in _samples())


def _samples() -> dict[str, Sample]:
    lines: Mapping[str, Sample] = {words: partial(_arrow, kind) for kind, words in _KINDS.items()}
    return {"start": _start, **lines, "from any state": _any, "operations that keep the state": _loop, "current": _now}


def _arrow(kind: Kind, into: Element, x: float, y: float) -> None:
    line(into, kind, f"M{point(x, y)}L{point(x + _SAMPLE - HEAD, y)}")
    head(into, kind, x + _SAMPLE, y, (1, 0))


def _any(into: Element, x: float, y: float) -> None:
    _arrow("transition", into, x, y)
    diamond(into, "transition", x + 5, y)


def _start(into: Element, x: float, y: float) -> None:
    start(into, x + _SAMPLE - 6, y - 10, 20)


def _loop(into: Element, x: float, y: float) -> None:
    loop(into, x + _SAMPLE - 6, y)


def _now(into: Element, x: float, y: float) -> None:
    box(into, x + 6, y - 7, _SAMPLE - 6, 14, 5, fill="#ffe08a", stroke=INK, stroke_width="3.2")
