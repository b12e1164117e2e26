"""Layout of one branch in its frame: gutter, captions, boxes and lanes from left to right, inner branches below."""

from __future__ import annotations

import itertools

from hypothesis import given

from pcmrs.authoring.chart._layout import layout
from pcmrs.authoring.chart._links import links
from pcmrs.authoring.chart._panel import PITCH, panel
from pcmrs.fsm.blueprint import Blueprint
from tests.support.trials import examples
from tests.unit.fsm.arm_workflow import arm_blueprint
from tests.unit.fsm.random_blueprints import blueprints


@examples(25)
@given(blueprints())
def test_parts_of_a_panel_are_side_by_side_in_its_frame(blueprint: Blueprint) -> None:
    for each in layout(blueprint).panels.values():
        columns, right, bottom = each.columns, each.x + each.width, each.y + each.height
        assert all(each.x < lane < columns.labels for lane in each.gutter.values())
        assert each.x < columns.labels <= columns.boxes < columns.boxes + columns.box_width <= columns.end < right
        lanes = [columns.lanes + PITCH * lane.number for lane in each.column.lanes]
        assert all(columns.boxes + columns.box_width < lane < right for lane in lanes)
        rows = list(each.column.rows.values())
        assert each.y < rows[0].y
        assert rows[-1].bottom < bottom
        assert all(one.bottom < other.y for one, other in itertools.pairwise(rows))
        assert all(rows[-1].bottom < child.y for child in each.children)


@examples(25)
@given(blueprints())
def test_a_lane_holds_one_link(blueprint: Blueprint) -> None:
    for each in layout(blueprint).panels.values():
        assert len(set(each.gutter.values())) == len(each.gutter)
        assert len(set(each.bars.values())) == len(each.bars)


def test_links_of_rules_run_in_the_gutter_of_the_parent() -> None:
    blueprint = arm_blueprint()
    joined = links(blueprint)
    made = panel(blueprint, joined, "robot", 0.0, 0.0)
    assert [inner.name for inner in made.walk()] == ["robot", "arm"]
    assert {link.kind for link in made.gutter} == {"signal", "call"}
    (arm,) = made.children
    assert arm.gutter == {}
    assert arm.subtitle == "arm: level 2, refines robot off"


def test_a_panel_moves_as_a_whole() -> None:
    blueprint = arm_blueprint()
    here, there = (panel(blueprint, links(blueprint), "robot", x, y) for x, y in ((0.0, 0.0), (30.0, 50.0)))
    assert (here.width, here.height) == (there.width, there.height)
    for one, other in zip(here.walk(), there.walk(), strict=True):
        assert (other.x - one.x, other.y - one.y) == (30.0, 50.0)
        assert [row.y + 50.0 for row in one.column.rows.values()] == [row.y for row in other.column.rows.values()]
