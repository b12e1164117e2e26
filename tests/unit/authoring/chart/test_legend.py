"""The legend of a chart: every kind of line is explained, within the width of the chart."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import pytest

from pcmrs.authoring.chart._canvas import STROKES
from pcmrs.authoring.chart._legend import LINE_HEIGHT, draw_legend, least_width
from pcmrs.authoring.chart._text import sans_width


def legend(width: float) -> tuple[Element, float]:
    root = Element("svg")
    return root, draw_legend(root, 10.0, 200.0, width)


def test_every_kind_of_line_is_in_the_legend() -> None:
    root, _ = legend(2000.0)
    strokes = {(path.get("stroke"), path.get("stroke-dasharray", "")) for path in root.iter("path")}
    assert {(stroke.colour, stroke.dashes) for stroke in STROKES.values()} <= strokes


@pytest.mark.parametrize("more", [0.0, 100.0, 700.0, 5000.0])
def test_texts_stay_within_the_width_and_above_the_lower_edge(more: float) -> None:
    width = least_width() + more
    root, bottom = legend(width)
    words = list(root.iter("text"))
    assert len({text.text for text in words}) == len(words) == 9
    for text in words:
        assert float(text.attrib["x"]) + sans_width(text.text or "", int(text.attrib["font-size"])) <= 10.0 + width
        assert 200.0 < float(text.attrib["y"]) < bottom


def test_a_narrow_legend_has_more_lines() -> None:
    assert legend(least_width())[1] > legend(700.0)[1] > legend(5000.0)[1] == 200.0 + LINE_HEIGHT
