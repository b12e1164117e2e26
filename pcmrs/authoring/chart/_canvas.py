"""SVG elements of a chart. All styles are attributes, so the picture looks the same in any page or on paper.

Colours are those of Okabe and Ito, which the colour-blind can tell apart; in grey, dashes and arrowheads differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement

from pcmrs.authoring.chart._arrows import Kind
from pcmrs.authoring.chart._text import MONO, SANS, clean

INK = "#1a1a1a"
"""Colour of texts and boxes."""

HEAD = 9.0
"""Length of an arrowhead in px."""


class _Stroke(NamedTuple):
    """Style of a kind of line: colour, dashes, width in px, and whether its head is filled."""

    colour: str
    dashes: str
    width: float
    filled: bool


STROKES: dict[Kind, _Stroke] = {
    "transition": _Stroke(INK, "", 1.3, True),
    "failure": _Stroke("#6b6b6b", "5 3", 1.2, False),
    "signal": _Stroke("#0072b2", "1.5 2.5", 1.7, False),
    "call": _Stroke("#00805f", "8 2.5 1.5 2.5", 1.5, True),
    "revocation": _Stroke("#c04a00", "11 4", 1.6, True),
}


def group(parent: Element, css_class: str, title: str = "", **data: str) -> Element:
    """Return a group with a tooltip and ``data-`` attributes.

    Args:
        parent: Element to append it to.
        css_class: Its class.
        title: Text of the tooltip.
        data: Value of each ``data-`` attribute.
    """
    attributes = {"class": css_class, **{f"data-{key}": clean(value) for key, value in data.items()}}
    element = SubElement(parent, "g", attributes)
    if title:
        SubElement(element, "title").text = clean(title)
    return element


def text(parent: Element, x: float, y: float, content: str, size: int, **given: str) -> None:
    """Draw a line of text; monospaced unless `font_family` says otherwise.

    Args:
        parent: Element to append it to.
        x: Start of the text, in px.
        y: Baseline of the text, in px.
        content: The text.
        size: Font size in px.
        given: Further attributes, with ``_`` for ``-``.
    """
    looks = {"font_family": MONO, "fill": INK, **given}
    attributes = {"x": _px(x), "y": _px(y), "font-size": str(size), **_dashed(looks)}
    SubElement(parent, "text", attributes).text = clean(content)


def sans(parent: Element, x: float, y: float, content: str, size: int, **given: str) -> None:
    """Draw a line of proportional text.

    Args:
        parent: Element to append it to.
        x: Start of the text, in px.
        y: Baseline of the text, in px.
        content: The text.
        size: Font size in px.
        given: Further attributes, with ``_`` for ``-``.
    """
    text(parent, x, y, content, size, font_family=SANS, **given)


def box(parent: Element, x: float, y: float, width: float, height: float, radius: float, **given: str) -> None:
    """Draw a rectangle with rounded corners.

    Args:
        parent: Element to append it to.
        x: Left edge, in px.
        y: Upper edge, in px.
        width: Width in px.
        height: Height in px.
        radius: Radius of the corners, in px.
        given: Further attributes, with ``_`` for ``-``.
    """
    size = {"x": _px(x), "y": _px(y), "width": _px(width), "height": _px(height), "rx": _px(radius)}
    SubElement(parent, "rect", {**size, **_dashed(given)})


def line(parent: Element, kind: Kind, path: str) -> None:
    """Draw a line along an SVG path.

    Args:
        parent: Element to append it to.
        kind: Kind of line, which gives its style.
        path: Path data.
    """
    stroke = STROKES[kind]
    attributes = {"d": path, "fill": "none", "stroke": stroke.colour, "stroke-width": str(stroke.width)}
    SubElement(parent, "path", {**attributes, **({"stroke-dasharray": stroke.dashes} if stroke.dashes else {})})


def dot(parent: Element, kind: Kind, x: float, y: float) -> None:
    """Draw a junction of two lines.

    Args:
        parent: Element to append it to.
        kind: Kind of line, which gives its colour.
        x: Centre, in px.
        y: Centre, in px.
    """
    SubElement(parent, "circle", {"cx": _px(x), "cy": _px(y), "r": "2.4", "fill": STROKES[kind].colour})


def diamond(parent: Element, kind: Kind, x: float, y: float) -> None:
    """Draw the mark that stands for any state.

    Args:
        parent: Element to append it to.
        kind: Kind of line, which gives its colour.
        x: Centre, in px.
        y: Centre, in px.
    """
    path = f"M{point(x - 5, y)}L{point(x, y - 4)}L{point(x + 5, y)}L{point(x, y + 4)}Z"
    SubElement(parent, "path", {"d": path, "fill": "#fff", "stroke": STROKES[kind].colour, "stroke-width": "1.2"})


def loop(parent: Element, x: float, y: float) -> None:
    """Draw a round arrow: the state is kept.

    Args:
        parent: Element to append it to.
        x: Centre, in px.
        y: Centre, in px.
    """
    circle = f"M{point(x + 3.5, y - 1.5)}A3.8 3.8 0 1 0 {point(x + 3, y + 2.3)}"
    SubElement(parent, "path", {"d": circle, "fill": "none", "stroke": INK, "stroke-width": "1.1"})
    tip = f"M{point(x + 5.4, y + 0.6)}L{point(x + 4.6, y - 3.6)}L{point(x + 1.4, y - 0.9)}Z"
    SubElement(parent, "path", {"d": tip, "fill": INK})


def start(parent: Element, x: float, y: float, length: float) -> None:
    """Draw the mark of the starting state: a dot with an arrow down from it.

    Args:
        parent: Element to append it to.
        x: Centre of the dot, in px.
        y: Centre of the dot, in px.
        length: Length of the arrow, in px.
    """
    SubElement(parent, "circle", {"cx": _px(x), "cy": _px(y + 4), "r": "4", "fill": INK})
    line(parent, "transition", f"M{point(x, y + 4)}L{point(x, y + length - HEAD)}")
    head(parent, "transition", x, y + length, (0, 1))


def head(parent: Element, kind: Kind, x: float, y: float, towards: tuple[int, int]) -> None:
    """Draw an arrowhead.

    Args:
        parent: Element to append it to.
        kind: Kind of line, which gives its style.
        x: Tip, in px.
        y: Tip, in px.
        towards: Direction: right (1, 0), left (-1, 0) or down (0, 1).
    """
    (along, down), side = towards, HEAD * 0.42
    base_x, base_y = x - HEAD * along, y - HEAD * down
    corners = [(x, y), (base_x - side * down, base_y - side * along), (base_x + side * down, base_y + side * along)]
    path = "M" + "L".join(point(*corner) for corner in corners) + "Z"
    stroke = STROKES[kind]
    looks = {"fill": stroke.colour if stroke.filled else "#fff", "stroke": stroke.colour, "stroke-width": "1.1"}
    SubElement(parent, "path", {"d": path, **looks})


def bus(lane: float, ends: Sequence[tuple[float, float]]) -> str:
    """Return the path from the highest end to the lane, along it, and out to the lowest end, with round corners.

    Args:
        lane: Position x of the lane, in px.
        ends: Points (x, y) of the ends, in px.
    """
    (x0, y0), *_, (x1, y1) = sorted(ends, key=lambda end: end[1])
    r = min(5.0, (y1 - y0) / 2)
    r0, r1 = (r if lane > x else -r for x in (x0, x1))
    return (
        f"M{point(x0, y0)}H{_px(lane - r0)}Q{point(lane, y0)} {point(lane, y0 + r)}"
        f"V{_px(y1 - r)}Q{point(lane, y1)} {point(lane - r1, y1)}H{_px(x1)}"
    )


def point(x: float, y: float) -> str:
    """Return coordinates as SVG paths have them.

    Args:
        x: Position in px.
        y: Position in px.
    """
    return f"{_px(x)} {_px(y)}"


def _px(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


def _dashed(given: Mapping[str, str]) -> dict[str, str]:
    return {key.replace("_", "-"): value for key, value in given.items()}
