"""Reachable joint states and their transitions, against a search that takes one at a time, and their limits."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given

from pcmrs.fsm.behaviour import joint_of
from pcmrs.fsm.blueprint import Blueprint, RevocationSpec
from pcmrs.fsm.verify import _space as space
from pcmrs.fsm.verify import verify
from pcmrs.fsm.verify._space import StateSpace
from tests.support.trials import examples
from tests.unit.fsm.large_blueprints import free
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.joint_state_oracle import levels, successors


@examples(60)
@given(blueprints())
@pytest.mark.nightly
def test_search_finds_each_joint_state_on_its_level(blueprint: Blueprint) -> None:
    """Every transition is counted."""
    expected = levels(blueprint)
    space = StateSpace(blueprint, 10_000)
    found = {
        joint_of(blueprint, space.encoding.decoded(int(code))): length
        for length, level in enumerate(space.reached.levels)
        for code in level
    }
    assert found == expected
    assert space.taken == sum(sum(successors(blueprint, joint).values()) for joint in expected)


@pytest.mark.parametrize("limit", [1, 2, 3])
def test_search_beyond_the_limit_reports_only_that(limit: int) -> None:
    blueprint = free(4, 2)
    found = verify(blueprint, limit=limit).findings
    assert [finding.code for finding in found] == ["too_many_states"]
    assert str(limit) in found[0].text


@pytest.mark.parametrize("branches", [63, 1500])
def test_more_combinations_than_an_integer_holds_are_refused(branches: int) -> None:
    (finding,) = verify(free(branches, 2)).findings
    assert finding.code == "too_many_states"
    assert "more than 2^62 combinations" in finding.text


@pytest.mark.nightly
def test_many_branches_with_a_single_state_take_no_decisions() -> None:
    """Each of them is looked at by the revocations of all others."""
    rules = [RevocationSpec(by=[f"b{n + 1}"], from_=["s0"], to="s0") for n in range(199)]
    branches = free(200, 1).branches
    tied = {
        name: msgspec.structs.replace(branch, revocations=[rule])
        for (name, branch), rule in zip(branches.items(), rules, strict=False)
    }
    blueprint = Blueprint(id="still", version="1.0.0", branches=branches | tied, goal={"b0": ["s0"]})
    assert verify(blueprint).joint_states == 1


def test_commands_that_depend_on_too_much_are_refused_early(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One branch revokes all others: each of its commands depends on everything at once."""
    monkeypatch.setattr(space, "MAX_DECISIONS", 300)
    branches = free(20, 2).branches
    rule = RevocationSpec(by=["b0"], from_=["s1"], to="s0")
    revoked = {name: msgspec.structs.replace(branch, revocations=[rule]) for name, branch in branches.items()}
    blueprint = Blueprint(id="star", version="1.0.0", branches={**revoked, "b0": branches["b0"]})
    found = verify(blueprint).findings
    assert [finding.code for finding in found] == ["too_many_states"]
    assert "depend on too many combinations" in found[0].text
