"""Drawing of laid out branches: lines begin and end at the boxes they join, and captions are above them."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import pytest

from pcmrs.authoring.chart import svg
from pcmrs.authoring.chart._canvas import HEAD
from pcmrs.authoring.chart._figure import caption, draw_panel
from pcmrs.authoring.chart._layout import layout
from pcmrs.authoring.chart._row import LINE, Port
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from tests.unit.authoring.chart import chart_reading as reading
from tests.unit.fsm.arm_workflow import arm_blueprint


def drawn(**operations: OperationSpec) -> Element:
    branch = BranchSpec(states=dict.fromkeys("abc", ""), operations=operations)
    return reading.parse(svg(Blueprint(id="x", version="1", branches={"x": branch})))


def test_a_straight_arrow_runs_from_box_to_box() -> None:
    root = drawn(on=OperationSpec(from_=["a"], to="b"))
    boxes = reading.states(root)
    ((line,),) = reading.segments(root)
    assert line.top == pytest.approx(boxes["x", "a"].bottom, abs=1.0)
    assert line.bottom == pytest.approx(boxes["x", "b"].top - HEAD, abs=1.0)
    assert boxes["x", "a"].left < line.left < line.right < boxes["x", "a"].right


def test_an_arrow_beside_joins_the_right_edges_of_its_boxes() -> None:
    root = drawn(over=OperationSpec(from_=["a"], to="c"))
    boxes = reading.states(root)
    (pieces,) = reading.segments(root)
    edge = boxes["x", "a"].right
    assert min(piece.left for piece in pieces) == pytest.approx(edge, abs=1.0)
    assert boxes["x", "a"].top < min(piece.top for piece in pieces) < boxes["x", "a"].bottom
    assert boxes["x", "c"].top < max(piece.bottom for piece in pieces) < boxes["x", "c"].bottom


def test_an_arrow_from_any_state_ends_at_the_left_edge() -> None:
    root = drawn(home=OperationSpec(from_=["*"], to="b"))
    boxes = reading.states(root)
    ((line,),) = reading.segments(root)
    assert line.right == pytest.approx(boxes["x", "b"].left - HEAD, abs=1.0)
    assert boxes["x", "b"].top < line.top < line.bottom < boxes["x", "b"].bottom


def test_a_branch_is_drawn_inside_the_group_of_its_parent() -> None:
    root = Element("svg")
    (panel,) = layout(arm_blueprint()).roots
    draw_panel(root, arm_blueprint(), panel, {"arm": "near"})
    (outer,) = root
    assert outer.attrib["data-branch"] == "robot"
    inner = [group.attrib["data-branch"] for group in outer if group.get("class") == "branch"]
    assert inner == ["arm"]
    current = [group.attrib["data-state"] for group in root.iter("g") if group.get("class") == "state current"]
    assert current == ["near"]


def test_lines_of_a_caption_are_stacked_above_its_line() -> None:
    root = Element("svg")
    caption(root, Port("line", ["failed:", "approach"], y=100.0), 50.0, "end")
    texts = {text.text: float(text.attrib["y"]) for text in root}
    assert texts["failed:"] + LINE == texts["approach"] < 100.0
