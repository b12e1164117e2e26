"""SVG elements of a chart, with all looks as attributes: the picture stays itself inside any page or paper.

Colours are those of Okabe and Ito, told apart by the colour-blind; in grey the dashes and arrowheads tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement

from pcmrs.authoring.chart.arrows import Kind
from pcmrs.authoring.chart.text import MONO, SANS, clean

INK = "#1a1a1a"
"""Colour of texts and boxes."""

HEAD = 9.0
"""Length of an arrowhead in px."""


class Stroke(NamedTuple):
    """How a kind of line is drawn: colour, dashes, width in px, and whether its head is filled."""

    colour: str
    dashes: str
    width: float
    filled: bool


STROKES: dict[Kind, Stroke] = {
    "transition": Stroke(INK, "", 1.3, True),
    "failure": Stroke("#6b6b6b", "5 3", 1.2, False),
    "signal": Stroke("#0072b2", "1.5 2.5", 1.7, False),
    "call": Stroke("#00805f", "8 2.5 1.5 2.5", 1.5, True),
    "revocation": Stroke("#c04a00", "11 4", 1.6, True),
}


def group(parent: Element, css_class: str, title: str = "", **data: str) -> Element:
    """A group with a tooltip and ``data-`` attributes."""
    attributes = {"class": css_class, **{f"data-{key}": clean(value) for key, value in data.items()}}
    element = SubElement(parent, "g", attributes)
    if title:
        SubElement(element, "title").text = clean(title)
    return element


def text(parent: Element, x: float, y: float, content: str, size: int, **given: str) -> None:
    """A line of text on the baseline `y`; monospaced unless `font_family` says otherwise."""
    looks = {"font_family": MONO, "fill": INK, **given}
    attributes = {"x": _px(x), "y": _px(y), "font-size": str(size), **_dashed(looks)}
    SubElement(parent, "text", attributes).text = clean(content)


def sans(parent: Element, x: float, y: float, content: str, size: int, **given: str) -> None:
    """A line of proportional text on the baseline `y`."""
    text(parent, x, y, content, size, font_family=SANS, **given)


def box(parent: Element, x: float, y: float, width: float, height: float, radius: float, **given: str) -> None:
    """A rectangle with rounded corners."""
    size = {"x": _px(x), "y": _px(y), "width": _px(width), "height": _px(height), "rx": _px(radius)}
    SubElement(parent, "rect", {**size, **_dashed(given)})


def line(parent: Element, kind: Kind, path: str) -> None:
    """A line along an SVG path."""
    stroke = STROKES[kind]
    attributes = {"d": path, "fill": "none", "stroke": stroke.colour, "stroke-width": str(stroke.width)}
    SubElement(parent, "path", {**attributes, **({"stroke-dasharray": stroke.dashes} if stroke.dashes else {})})


def dot(parent: Element, kind: Kind, x: float, y: float) -> None:
    """A junction of two lines."""
    SubElement(parent, "circle", {"cx": _px(x), "cy": _px(y), "r": "2.4", "fill": STROKES[kind].colour})


def diamond(parent: Element, kind: Kind, x: float, y: float) -> None:
    """The mark of any state."""
    path = f"M{point(x - 5, y)}L{point(x, y - 4)}L{point(x + 5, y)}L{point(x, y + 4)}Z"
    SubElement(parent, "path", {"d": path, "fill": "#fff", "stroke": STROKES[kind].colour, "stroke-width": "1.2"})


def loop(parent: Element, x: float, y: float) -> None:
    """A round arrow: the state is kept."""
    circle = f"M{point(x + 3.5, y - 1.5)}A3.8 3.8 0 1 0 {point(x + 3, y + 2.3)}"
    SubElement(parent, "path", {"d": circle, "fill": "none", "stroke": INK, "stroke-width": "1.1"})
    tip = f"M{point(x + 5.4, y + 0.6)}L{point(x + 4.6, y - 3.6)}L{point(x + 1.4, y - 0.9)}Z"
    SubElement(parent, "path", {"d": tip, "fill": INK})


def start(parent: Element, x: float, y: float, length: float) -> None:
    """The mark of the starting state: a dot at (x, y) with an arrow down from it."""
    SubElement(parent, "circle", {"cx": _px(x), "cy": _px(y + 4), "r": "4", "fill": INK})
    line(parent, "transition", f"M{point(x, y + 4)}L{point(x, y + length - HEAD)}")
    head(parent, "transition", x, y + length, (0, 1))


def head(parent: Element, kind: Kind, x: float, y: float, towards: tuple[int, int]) -> None:
    """An arrowhead with its tip at (x, y), pointing right (1, 0), left (-1, 0) or down (0, 1)."""
    (along, down), side = towards, HEAD * 0.42
    base_x, base_y = x - HEAD * along, y - HEAD * down
    corners = [(x, y), (base_x - side * down, base_y - side * along), (base_x + side * down, base_y + side * along)]
    path = "M" + "L".join(point(*corner) for corner in corners) + "Z"
    stroke = STROKES[kind]
    looks = {"fill": stroke.colour if stroke.filled else "#fff", "stroke": stroke.colour, "stroke-width": "1.1"}
    SubElement(parent, "path", {"d": path, **looks})


def bus(lane: float, ends: Sequence[tuple[float, float]]) -> str:
    """Path from the highest end to the lane at x, along it, and out to the lowest end, with round corners."""
    (x0, y0), *_, (x1, y1) = sorted(ends, key=lambda end: end[1])
    r = min(5.0, (y1 - y0) / 2)
    r0, r1 = (r if lane > x else -r for x in (x0, x1))
    return (
        f"M{point(x0, y0)}H{_px(lane - r0)}Q{point(lane, y0)} {point(lane, y0 + r)}"
        f"V{_px(y1 - r)}Q{point(lane, y1)} {point(lane - r1, y1)}H{_px(x1)}"
    )


def point(x: float, y: float) -> str:
    """Coordinates as SVG paths have them."""
    return f"{_px(x)} {_px(y)}"


def _px(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


def _dashed(given: Mapping[str, str]) -> dict[str, str]:
    return {key.replace("_", "-"): value for key, value in given.items()}
