"""Diagrams of draw.io as blueprints."""

from __future__ import annotations

import pytest

from pcmrs.authoring.exchange.importing.drawio import from_drawio


def page(*cells: str) -> bytes:
    inside = "\n".join(['<mxCell id="0"/>', '<mxCell id="1" parent="0"/>', *cells])
    return f"<mxGraphModel><root>\n{inside}</root></mxGraphModel>".encode()


A = '<mxCell id="a" value="a" vertex="1" parent="1"/>'
B = '<mxCell id="b" value="b" vertex="1" parent="1"/>'
START = (
    '<mxCell id="s" style="ellipse" vertex="1" parent="1"/><mxCell id="t" edge="1" source="s" target="a" parent="1"/>'
)


@pytest.mark.parametrize(
    ("cells", "code", "line"),
    [
        ((A, B), "no_start", 1),
        ((A, B, START, '<mxCell id="e" edge="1" source="a" target="b" parent="1"/>'), "not_supported", 7),
        ((A, B, START, '<mxCell id="e" value="x" edge="1" source="a" parent="1"/>'), "not_supported", 7),
        ((A, B, START, '<mxCell id="e" value="x" edge="1" source="s" target="b" parent="1"/>'), "not_supported", 7),
        ((A, '<mxCell id="c" style="rhombus" vertex="1" parent="1"/>'), "not_supported", 5),
        ((A, '<mxCell id="c" style="rounded=1" vertex="1" parent="1"/>'), "bad_name", 5),
        ((A, A.replace('value="a"', 'value="c"')), "name_collision", 5),
        ((A, START, '<mxCell id="c" value="A" vertex="1" parent="1"/>'), "name_collision", 6),
        ((), "no_states", 1),
    ],
)
def test_unsupported_drawio_is_named_with_its_line(cells: tuple[str, ...], code: str, line: int) -> None:
    blueprint, findings = from_drawio(page(*cells), "door.drawio")
    assert blueprint is None
    assert [(f.code, f.file, f.line) for f in findings] == [(code, "door.drawio", line)]


def test_separate_label_wrapped_cell_and_end_in_drawio() -> None:
    more = (
        '<mxCell id="e" edge="1" source="a" target="b" parent="1"/>'
        '<mxCell id="l" value="go" style="edgeLabel" vertex="1" parent="e"/>',
        '<object label="come back" id="f"><mxCell edge="1" source="b" target="a" parent="1"/></object>',
        '<mxCell id="end" style="ellipse;shape=endState" vertex="1" parent="1"/>'
        '<mxCell id="g" edge="1" source="b" target="end" parent="1"/>',
        '<mxCell id="n" value="a remark" style="text;html=1" vertex="1" parent="1"/>',
    )
    blueprint, findings = from_drawio(page(A, B, START, *more))
    assert blueprint is not None, findings
    assert {name: (o.from_, o.to) for name, o in blueprint.branches["main"].operations.items()} == {
        "go": (["a"], "b"),
        "come_back": (["b"], "a"),
    }
    assert blueprint.goal == {"main": ["b"]}


SIDE_BY_SIDE = """
<mxCell id="p" value="door" style="swimlane" vertex="1" parent="1"/>
<mxCell id="p1" value="shut" vertex="1" parent="p"/>
<mxCell id="p2" value="ajar" vertex="1" parent="p"/>
<mxCell id="p0" style="ellipse" vertex="1" parent="p"/>
<mxCell id="p3" edge="1" source="p0" target="p1" parent="p"/>
<mxCell id="p4" value="open" edge="1" source="p1" target="p2" parent="p"/>
<mxCell id="q" value="lamp" style="swimlane" vertex="1" parent="1"/>
<mxCell id="q1" value="off" vertex="1" parent="q"/>
<mxCell id="q2" value="on" vertex="1" parent="q"/>
<mxCell id="q0" style="ellipse" vertex="1" parent="q"/>
<mxCell id="q3" edge="1" source="q0" target="q1" parent="q"/>
<mxCell id="q4" value="switch" edge="1" source="q1" target="q2" parent="q"/>
"""


def test_containers_side_by_side_in_drawio_are_branches() -> None:
    blueprint, findings = from_drawio(page(SIDE_BY_SIDE))
    assert blueprint is not None, findings
    assert {name: (spec.level, list(spec.states)) for name, spec in blueprint.branches.items()} == {
        "door": (1, ["shut", "ajar"]),
        "lamp": (1, ["off", "on"]),
    }


def test_an_arrow_between_containers_side_by_side_leaves_both() -> None:
    across = '<mxCell id="x" value="alarm" edge="1" source="p1" target="q2" parent="1"/>'
    blueprint, findings = from_drawio(page(SIDE_BY_SIDE, across))
    assert blueprint is not None, findings
    alarm = blueprint.branches["main"].operations["alarm"]
    assert (alarm.from_, alarm.to, alarm.requires) == (["*"], "page", {"door": ["shut"]})
    assert alarm.sets == {"door": "shut", "lamp": "on"}
