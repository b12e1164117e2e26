"""Cascades that are remembered, against those that are followed again."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given

from pcmrs.fsm.behaviour import branch_states, operations
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec, RevocationSpec
from pcmrs.fsm.closure import Change, follow_cascade
from pcmrs.fsm.verify import _cascades as cascades
from pcmrs.fsm.verify.decision import Decider
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.joint_state_oracle import levels


@examples(25)
@given(blueprints())
def test_remembered_cascades_change_no_decision(blueprint: Blueprint) -> None:
    """No cascade is followed where one with the same beginning and the same states that matter was followed before."""
    followed: list[tuple[Any, ...]] = []

    def count(order: Blueprint, *rest: Any) -> Change:
        followed.append(rest)
        return follow_cascade(order, *rest)

    everywhere = [branch_states(blueprint, joint) for joint in levels(blueprint)][:20]
    asked = [(states, branch, operation) for states in everywhere for branch, operation, _ in operations(blueprint)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cascades, "follow_cascade", count)
        decider = Decider(blueprint)
        first = [decider.decide(*each) for each in asked]
        known = len(followed)
        again = [decider.decide(*each) for each in asked]
        assert len(followed) == known
        fresh = [Decider(blueprint).decide(*each) for each in asked]
    for one, other, alone in zip(first, again, fresh, strict=True):
        assert list(one.seen.items()) == list(other.seen.items()) == list(alone.seen.items())
        assert (one.denied, one.endings, one.calls) == (other.denied, other.endings, other.calls)
        assert (one.denied, one.endings, one.calls) == (alone.denied, alone.endings, alone.calls)


def test_a_target_by_source_and_a_plain_one_share_what_follows() -> None:
    """The search ended with a TypeError, since only one of them looks at the state of its own branch."""
    plain = OperationSpec(from_=["a"], to="a")
    by_source = OperationSpec(from_=["a", "b"], to={"a": "a", "b": "a"})
    one = BranchSpec(states=dict.fromkeys("ab", ""), operations={"plain": plain, "by_source": by_source})
    rule = RevocationSpec(by=["one"], from_=["d"], to="c")
    other = BranchSpec(states=dict.fromkeys("cd", ""), revocations=[rule])
    decider = Decider(Blueprint(id="two", version="1", branches={"one": one, "other": other}))
    for state, left in (("c", "c"), ("d", "c")):
        for operation in ("plain", "by_source"):
            decision = decider.decide({"one": "a", "other": state}, "one", operation)
            assert decision.denied is None
            assert {each.get("other", state) for each in decision.endings.values()} == {left}
