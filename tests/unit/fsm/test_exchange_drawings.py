"""The same chart in Mermaid and draw.io becomes the same workflow as in SCXML."""

from __future__ import annotations

from random import Random

import pytest

from pcmrs.authoring.chart import mermaid
from pcmrs.authoring.exchange.importing.drawio import from_drawio
from pcmrs.authoring.exchange.importing.mermaid import from_mermaid
from pcmrs.authoring.exchange.importing.scxml import from_scxml
from pcmrs.fsm import Blueprint
from pcmrs.fsm.behaviour import behaviour
from pcmrs.fsm.finding import Finding
from tests.unit.fsm.random_blueprints import random_blueprint
from tests.unit.fsm.random_charts import as_drawio, as_mermaid, as_scxml, random_chart

Import = tuple[Blueprint | None, list[Finding]]


def drawings(seed: int) -> list[Import]:
    """Imports of one chart: from SCXML, Mermaid, draw.io and compressed draw.io."""
    chart = random_chart(Random(seed), plain=True)
    return [
        from_scxml(as_scxml(chart).encode()),
        from_mermaid(as_mermaid(chart).encode()),
        from_drawio(as_drawio(chart, compressed=False).encode()),
        from_drawio(as_drawio(chart, compressed=True).encode()),
    ]


def test_one_chart_in_every_notation() -> None:
    imported = 0
    for seed in range(80):
        (blueprint, findings), *others = drawings(seed)
        imported += blueprint is not None
        for other, said in others:
            assert {f.code for f in said} == {f.code for f in findings}, (seed, findings, said)
            assert (other and other.branches) == (blueprint and blueprint.branches), seed
    assert imported > 40


def test_a_drawn_workflow_of_one_branch_is_read_again() -> None:
    """Our own Mermaid has an arrow from `any state` and remarks in brackets."""
    read = 0
    for seed in range(200):
        blueprint = random_blueprint(Random(seed), plain=True)
        name, *others = blueprint.branches
        if others:
            continue
        again, findings = from_mermaid(mermaid(blueprint).encode())
        assert again is not None, findings
        old, new = behaviour(blueprint), behaviour(again)
        assert list(again.branches) == [name]
        assert {joint: {c for c in a if not hasattr(a[c], "code")} for joint, a in old.items()} == {
            joint: {c for c in a if not hasattr(a[c], "code")} for joint, a in new.items()
        }
        read += 1
    assert read > 20


DOOR = """---
title: Door
---
stateDiagram-v2
    direction LR
    %% what one can do with a door
    [*] --> closed
    closed --> open : push (gently)
    open --> closed : pull, slam
    closed --> [*]
    state "stands open" as open
    state open {
        [*] --> ajar
        ajar --> wide : push
        note right of ajar : seen often
        note left of wide
            several --> lines : x
        end note
    }
    classDef red fill:#f00
    class open red
"""


def test_irrelevant_mermaid_lines_are_ignored() -> None:
    blueprint, findings = from_mermaid(DOOR.encode())
    assert blueprint is not None, findings
    assert {name: list(spec.states) for name, spec in blueprint.branches.items()} == {
        "main": ["closed", "open"],
        "open": ["ajar", "wide"],
    }
    assert blueprint.branches["main"].states["open"] == "stands open"
    assert blueprint.goal == {"main": ["closed"]}
    assert [f"{o}: {s.from_}" for o, s in blueprint.branches["main"].operations.items() if not s.iio] == [
        "push: ['closed']",
        "pull: ['open']",
        "slam: ['open']",
    ]


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("state decide <<choice>>", "not_supported"),
        ("state both <<fork>>", "not_supported"),
        ("a --> b", "not_supported"),
        ("a --> b : go [if warm]", "not_supported"),
        ("a --> b : go / beep", "not_supported"),
        ("a --> [*] : leave", "not_supported"),
        ("[*] --> b", "not_supported"),
        ("a ==> b", "not_mermaid"),
        ("}", "not_mermaid"),
        ("state c {", "not_mermaid"),
        ("a --> b : class", "reserved_name"),
        ("a --> b : 1st", "bad_name"),
        ("A --> a : go", "name_collision"),
    ],
)
def test_unsupported_mermaid_is_named_with_its_line(line: str, code: str) -> None:
    raw = f"stateDiagram-v2\n[*] --> a\n  {line}\n"
    blueprint, findings = from_mermaid(raw.encode(), "door.mmd")
    assert blueprint is None
    assert [(f.code, f.file, f.line) for f in findings] == [(code, "door.mmd", 3)]


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
