"""SVG elements of a chart: kinds of lines that differ in grey, arrowheads, and lines that join their ends."""

from __future__ import annotations

import re
from xml.etree.ElementTree import Element

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.chart._canvas import HEAD, STROKES, bus, group, head, point, text

NUMBER = r"-?\d+(?:\.\d)?"
PLACES = st.tuples(st.integers(-200, 200), st.integers(-200, 200))


def numbers(path: str) -> list[float]:
    return [float(number) for number in re.findall(NUMBER, path)]


def test_kinds_of_lines_differ_without_colour() -> None:
    assert len({(stroke.dashes, stroke.filled) for stroke in STROKES.values()}) == len(STROKES)
    assert len({stroke.colour for stroke in STROKES.values()}) == len(STROKES)


@pytest.mark.parametrize("towards", [(1, 0), (-1, 0), (0, 1)])
def test_an_arrowhead_ends_at_its_tip(towards: tuple[int, int]) -> None:
    root = Element("svg")
    head(root, "transition", 40, 60, towards)
    x0, y0, x1, y1, x2, y2 = numbers(root[0].attrib["d"])
    along, down = towards
    assert (x0, y0) == (40, 60)
    assert ((x1 + x2) / 2, (y1 + y2) / 2) == (40 - HEAD * along, 60 - HEAD * down)
    assert (x1, y1) != (x2, y2)


@given(st.lists(PLACES, min_size=2, max_size=5, unique_by=lambda end: end[1]), st.integers(-300, 300))
def test_a_bus_runs_from_the_highest_end_to_the_lowest(ends: list[tuple[int, int]], lane: int) -> None:
    path = bus(lane, ends)
    (first, top), *_, (last, bottom) = sorted(ends, key=lambda end: end[1])
    assert path.startswith(f"M{first} {top}H")
    assert path.endswith(f"H{last}")
    found = re.fullmatch(
        rf"M{NUMBER} {NUMBER}H{NUMBER}Q({NUMBER}) ({NUMBER}) .*V{NUMBER}Q({NUMBER}) ({NUMBER}) .*H{NUMBER}", path
    )
    assert found is not None
    assert [float(corner) for corner in found.groups()] == [lane, top, lane, bottom]


def test_coordinates_have_one_decimal_at_most() -> None:
    assert point(1.04, 2.0) == "1 2"
    assert point(-0.25, 7.96) == "-0.2 8"


def test_texts_and_data_of_any_workflow_are_cleaned() -> None:
    root = Element("svg")
    drawn = group(root, "state", "a\x00\nb", branch="x\x1by")
    text(drawn, 1, 2, "two\nlines", 10, text_anchor="end")
    assert drawn.attrib == {"class": "state", "data-branch": "x\ufffdy"}
    title, words = drawn
    assert (title.text, words.text) == ("a\ufffd b", "two lines")
    assert words.attrib["text-anchor"] == "end"
    assert len(group(root, "branch")) == 0
