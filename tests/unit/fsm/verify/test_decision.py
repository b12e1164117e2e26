"""Decisions: the branches that an answer depends on, against the answers in every joint state."""

from __future__ import annotations

from pathlib import Path

import msgspec
from hypothesis import given

from pcmrs.fsm.behaviour import branch_states, endings, operations
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Closure, close
from pcmrs.fsm.files.load import read_blueprint
from pcmrs.fsm.verify.decision import Decider, DecisionCase
from tests.support.trials import examples
from tests.unit.fsm.large_blueprints import free
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.joint_state_oracle import answer_in, levels


@examples(25)
@given(blueprints())
def test_an_answer_depends_on_nothing_but_what_was_seen(blueprint: Blueprint) -> None:
    everywhere = [branch_states(blueprint, joint) for joint in levels(blueprint)]
    decider = Decider(blueprint)
    for branch, operation, _ in operations(blueprint):
        for states in everywhere[:5]:
            decision = decider.decide(states, branch, operation)
            alike = [other for other in everywhere if decision.seen.items() <= other.items()]
            assert states in alike
            for other in alike:
                check_answer(decision, blueprint, other, branch, operation)


def check_answer(
    decision: DecisionCase, blueprint: Blueprint, states: dict[str, str], branch: str, operation: str
) -> None:
    """A decision is the answer to the operation in a joint state, without the branches that it does not touch."""
    answer = close(blueprint, states, branch, operation)
    assert decision.accepted == isinstance(answer, Closure)
    if not isinstance(answer, Closure):
        assert (decision.denied, decision.endings) == (answer.code, {})
        return
    expected = endings(blueprint.branches[branch].operations[operation], answer)
    assert decision.endings == {name: change.targets if change else {} for name, change in expected.items()}
    assert decision.declared == answer.outcomes.keys()
    assert decision.locks == (answer.writes, answer.reads)
    possible = [*answer.outcomes.values(), *filter(None, (answer.failure, answer.unknown))]
    assert decision.calls == {
        (effect.branch, effect.operation) for change in possible for effect in change.effects if effect.kind == "signal"
    }


@examples(60)
@given(blueprints())
def test_order_matters_if_both_orders_differ(blueprint: Blueprint) -> None:
    other = msgspec.structs.replace(blueprint, branches=dict(reversed(blueprint.branches.items())))
    decider = Decider(blueprint, other)
    for states in [branch_states(blueprint, joint) for joint in levels(blueprint)][:8]:
        for branch, operation, _ in operations(blueprint):
            results = [answer_in(each, states, branch, operation) for each in (blueprint, other)]
            assert decider.decide(states, branch, operation).ordered == (results[0] != results[1])


def test_operations_of_free_branches_see_only_their_own() -> None:
    blueprint = free(5, 3)
    for branch, operation, _ in operations(blueprint):
        assert set(Decider(blueprint).decide(blueprint.initial(), branch, operation).seen) == {branch}


def test_an_effect_that_depends_on_branch_order_is_marked() -> None:
    """A door revokes the light of a lamp, which rings a bell, and it silences the bell: which comes first?"""
    file = Path(__file__).parents[1] / "unsound" / "order_dependent.toml"
    blueprint, _ = read_blueprint(file.read_bytes(), file.name)
    assert blueprint is not None
    orders = (blueprint, msgspec.structs.replace(blueprint, branches=dict(reversed(blueprint.branches.items()))))
    lit = {"door": "closed", "lamp": "lit", "bell": "quiet"}
    assert Decider(*orders).decide(lit, "door", "open").ordered
    assert not Decider(*orders).decide(lit | {"lamp": "dark"}, "door", "open").ordered
    assert not Decider(*orders[:1]).decide(lit, "door", "open").ordered
