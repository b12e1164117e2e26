"""Decision trees of all operations together, against the decision about each operation in each joint state."""

from __future__ import annotations

import numpy as np
from hypothesis import given

from pcmrs.fsm.behaviour import branch_states
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.verify._encoding import Batch
from pcmrs.fsm.verify._forest import Forest
from pcmrs.fsm.verify._space import StateSpace
from pcmrs.fsm.verify.decision import Decider, DecisionCase
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.joint_state_oracle import levels


@examples(25)
@given(blueprints())
def test_each_joint_state_gets_the_decision_made_there(blueprint: Blueprint) -> None:
    space = StateSpace(blueprint, 10_000)
    for batch in space.reached.batches():
        decisions = space.decided(batch)
        assert decisions.shape == (len(space.operations), len(batch.codes))
        for (number, row), found in zip(np.ndindex(decisions.shape), decisions.flat, strict=True):
            operation = space.operations[number]
            states = space.encoding.decoded(int(batch.codes[row]))
            expected = Decider(blueprint).decide(states, operation.branch, operation.operation)
            about, decision = space.numbered[found]
            assert about == number
            assert expected.seen.items() <= decision.seen.items() <= states.items()  # the order of branches adds some
            assert (decision.denied, decision.endings) == (expected.denied, expected.endings)


@examples(25)
@given(blueprints())
def test_no_decision_is_made_twice(blueprint: Blueprint) -> None:
    """However the joint states are divided, and in whatever order they come."""
    space = StateSpace(blueprint, 10_000)
    asked: list[tuple[int, int]] = []

    def count(number: int, code: int) -> DecisionCase:
        asked.append((number, code))
        operation = space.operations[number]
        return Decider(blueprint).decide(space.encoding.decoded(code), operation.branch, operation.operation)

    forest = Forest(space.encoding, [space.encoding.position[each.branch] for each in space.operations], count)
    codes = [space.encoding.code(branch_states(blueprint, joint)) for joint in levels(blueprint)]
    for some in (codes[::-2], codes[-2::-2], codes):
        forest.evaluate(Batch(space.encoding, np.array(some, dtype=np.int64)))
    assert len(asked) == len(forest.learned) == len(space.numbered)
    seen = [(number, frozenset(decision.seen.items())) for number, decision in forest.learned]
    assert len(seen) == len(set(seen))
