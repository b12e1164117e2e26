"""Reads a chart's SVG back: its states, captions and lines as geometry, without a word from the code that drew it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

SVG = "{http://www.w3.org/2000/svg}"

GLYPH_EM = 0.6
"""Advance of the narrowest of the monospaced fonts in use, so that what overlaps here overlaps for everybody."""


class Rectangle(NamedTuple):
    """Edges in px."""

    left: float
    top: float
    right: float
    bottom: float

    @property
    def lies(self) -> bool:
        """Whether it is wider than high."""
        return self.right - self.left > self.bottom - self.top

    def meets(self, other: Rectangle) -> bool:
        """Whether they have more than an edge in common."""
        across = min(self.right, other.right) - max(self.left, other.left)
        return across > 0.2 and min(self.bottom, other.bottom) - max(self.top, other.top) > 0.2


def parse(svg: str) -> Element:
    """The root element; raises what the XML parser raises."""
    return ElementTree.fromstring(svg)


def groups(root: Element, css_class: str) -> list[Element]:
    """Groups that have the class."""
    return [group for group in root.iter(f"{SVG}g") if css_class in group.get("class", "").split()]


def states(root: Element) -> dict[tuple[str, str], Rectangle]:
    """Box of every state: (branch, state)."""
    return {(g.attrib["data-branch"], g.attrib["data-state"]): _box(g) for g in groups(root, "state")}


def highlighted(root: Element) -> set[tuple[str, str]]:
    """Branch and state of what is shown as current."""
    return {(g.attrib["data-branch"], g.attrib["data-state"]) for g in groups(root, "current")}


def frames(root: Element) -> dict[str, Rectangle]:
    """Frame of every branch."""
    return {g.attrib["data-branch"]: _box(g) for g in groups(root, "branch")}


def texts(element: Element) -> str:
    """All text that is shown, in the order of the file, blank between pieces."""
    return " ".join(text.text or "" for text in element.iter(f"{SVG}text"))


def captions(root: Element) -> list[Rectangle]:
    """Where the monospaced captions of arrows and links stand: from the baseline up to the height of capitals."""
    owners = [*groups(root, "arrow"), *groups(root, "link")]
    return [_extent(text) for owner in owners for text in owner.findall(f"{SVG}text")]


def segments(root: Element) -> list[list[Rectangle]]:
    """For each arrow and link the straight pieces of its lines, as thick as they are drawn."""
    owners = [*groups(root, "arrow"), *groups(root, "link")]
    lines = [[path for path in owner.findall(f"{SVG}path") if path.get("fill") == "none"] for owner in owners]
    return [[piece for path in paths for piece in _pieces(path)] for paths in lines]


def _box(group: Element) -> Rectangle:
    rect = group.find(f"{SVG}rect")
    assert rect is not None
    x, y, width, height = (float(rect.attrib[key]) for key in ("x", "y", "width", "height"))
    return Rectangle(x, y, x + width, y + height)


def _extent(text: Element) -> Rectangle:
    x, y, size = (float(text.attrib[key]) for key in ("x", "y", "font-size"))
    width = len(text.text or "") * size * GLYPH_EM
    left = {"end": x - width, "middle": x - width / 2}.get(text.get("text-anchor", "start"), x)
    return Rectangle(left, y - 0.7 * size, left + width, y)


def _pieces(path: Element) -> Iterator[Rectangle]:
    half, x, y = float(path.attrib["stroke-width"]) / 2, 0.0, 0.0
    for command, given in re.findall(r"([MLHVQ])([-0-9. ]+)", path.attrib["d"]):
        numbers = [float(number) for number in given.split()]
        to_x = numbers[0] if command == "H" else x if command == "V" else numbers[-2]
        to_y = numbers[0] if command == "V" else y if command == "H" else numbers[-1]
        if command != "M":
            yield Rectangle(min(x, to_x) - half, min(y, to_y) - half, max(x, to_x) + half, max(y, to_y) + half)
        x, y = to_x, to_y
