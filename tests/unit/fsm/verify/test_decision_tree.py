"""Decisions: the branches that an answer depends on, against the answers in every joint state."""

from __future__ import annotations

from pathlib import Path

import msgspec
from hypothesis import given

from pcmrs.fsm.behaviour import branch_states, operations
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.files.load import read_blueprint
from pcmrs.fsm.verify.decision_tree import decide
from pcmrs.fsm.verify.space import Space
from tests.support.trials import examples
from tests.unit.fsm.large_blueprints import free
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.joint_state_oracle import answer_in, essence, levels


@examples(25)
@given(blueprints())
def test_an_answer_depends_on_nothing_but_what_was_seen(blueprint: Blueprint) -> None:
    everywhere = [branch_states(blueprint, joint) for joint in levels(blueprint)]
    for branch, operation, _ in operations(blueprint):
        for states in everywhere[:5]:
            decision = decide([blueprint], states, branch, operation)
            alike = [other for other in everywhere if decision.seen.items() <= other.items()]
            assert states in alike
            assert all(answer_in(blueprint, other, branch, operation) == essence(decision.answer) for other in alike)


@examples(25)
@given(blueprints())
def test_decisions_divide_all_joint_states(blueprint: Blueprint) -> None:
    space = Space(blueprint, 10_000)
    for batch in space.reached.batches():
        for operation in space.operations:
            parts = list(operation.split(batch))
            assert sorted(int(row) for _, rows in parts for row in rows) == list(range(len(batch.codes)))
            for decision, rows in parts:
                states = [space.encoding.decoded(int(code)) for code in batch.codes[rows]]
                assert all(decision.seen.items() <= each.items() for each in states)


def test_operations_of_free_branches_see_only_their_own() -> None:
    blueprint = free(5, 3)
    for branch, operation, _ in operations(blueprint):
        assert set(decide([blueprint], blueprint.initial(), branch, operation).seen) == {branch}


def test_an_effect_that_depends_on_branch_order_is_marked() -> None:
    """A door revokes the light of a lamp, which rings a bell, and it silences the bell: which comes first?"""
    file = Path(__file__).parents[1] / "unsound" / "order_dependent.toml"
    blueprint, _ = read_blueprint(file.read_bytes(), file.name)
    assert blueprint is not None
    orders = (blueprint, msgspec.structs.replace(blueprint, branches=dict(reversed(blueprint.branches.items()))))
    lit = {"door": "closed", "lamp": "lit", "bell": "quiet"}
    assert decide(orders, lit, "door", "open").ordered
    assert not decide(orders, lit | {"lamp": "dark"}, "door", "open").ordered
    assert not decide(orders[:1], lit, "door", "open").ordered
