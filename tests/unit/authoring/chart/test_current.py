"""Limits of a chart, and the states that are highlighted in it."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.chart import dot, mermaid, svg
from pcmrs.authoring.chart._current import MAX_LEVEL
from pcmrs.errors import ConfigurationError
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec, ParentSpec
from tests.support.shipped import shipped_blueprint
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints


@pytest.mark.parametrize(("current", "known"), [({"arm": "1"}, "registration"), ({"robot": "7"}, "0, 1")])
def test_an_unknown_state_is_refused_with_those_there_are(current: dict[str, str], known: str) -> None:
    with pytest.raises(ConfigurationError, match=known):
        svg(shipped_blueprint("ratms"), current)


texts = examples(25)


@texts
@given(blueprints(), st.data())
def test_texts_highlight_just_the_given_states(blueprint: Blueprint, data: st.DataObject) -> None:
    chosen = data.draw(st.lists(st.sampled_from(list(blueprint.branches)), unique=True))
    current = {name: data.draw(st.sampled_from(list(blueprint.branches[name].states))) for name in chosen}
    assert set(re.findall(r"class (\w+)_IS_(\w+) current", mermaid(blueprint, current))) == set(current.items())
    assert set(re.findall(r'"(\w+)\.(\w+)" \[.*penwidth', dot(blueprint, current))) == set(current.items())


@pytest.mark.parametrize("draw", [svg, dot, mermaid])
def test_too_deep_nesting_is_refused(draw: Callable[[Blueprint], str]) -> None:
    levels = {f"b{level}": nested(level) for level in range(1, MAX_LEVEL + 2)}
    with pytest.raises(ConfigurationError, match="65 levels"):
        draw(Blueprint(id="x", version="1", branches=levels))
    del levels["b65"]
    assert "b64" in draw(Blueprint(id="x", version="1", branches=levels))


def nested(level: int) -> BranchSpec:
    parent = ParentSpec(branch=f"b{level - 1}", start="a", compatible={"a": ["a"]}) if level > 1 else None
    called = OperationSpec(from_=["*"], to="a", iio=True)
    emits = {"a": "called"} if parent else {}
    return BranchSpec(level=level, states={"a": ""}, parent=parent, emits=emits, operations={"called": called})
