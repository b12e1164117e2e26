"""Mermaid state diagrams as blueprints."""

from __future__ import annotations

from random import Random

import pytest

from pcmrs.authoring.chart import mermaid
from pcmrs.authoring.exchange.importing.mermaid import from_mermaid
from pcmrs.fsm.behaviour import behaviour
from tests.unit.fsm.random_blueprints import random_blueprint


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
