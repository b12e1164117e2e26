"""The state chart as Mermaid text."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.chart import mermaid
from pcmrs.fsm.blueprint import Blueprint, BranchSpec
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints

texts = examples(25)


def in_order(blueprint: Blueprint) -> list[tuple[str, str]]:
    return [(name, state) for name, branch in blueprint.branches.items() for state in branch.states]


@texts
@given(blueprints())
def test_mermaid_has_every_state_and_balanced_composites(blueprint: Blueprint) -> None:
    lines = [line.strip() for line in mermaid(blueprint).splitlines()]
    assert lines[0] == "stateDiagram-v2"
    assert sum(line.endswith("{") for line in lines) == lines.count("}") == len(blueprint.branches) + 1
    declared = [match.groups() for line in lines if (match := re.fullmatch(r'state ".*" as (\w+)_IS_(\w+)', line))]
    assert sorted(declared) == sorted(in_order(blueprint))
    assert lines.count("--") == len(blueprint.branches) - 1
    assert sum(line.startswith("[*] -->") for line in lines) == len(blueprint.branches)


@texts
@given(st.text())
def test_no_text_breaks_out_of_its_mermaid_line(text: str) -> None:
    plain = mermaid(Blueprint(id="x", version="1", title="t", branches={"b": BranchSpec(states={"a": "t"})}))
    odd = mermaid(Blueprint(id="x", version="1", title=text or "t", branches={"b": BranchSpec(states={"a": text})}))
    assert len(odd.splitlines()) == len(plain.splitlines())
    state = next(line for line in odd.splitlines() if line.endswith(" as b_IS_a"))
    assert state.count('"') == 2
    assert not re.search(r"[:;{}<>%]", re.sub(r"#\d+;", "", state))
