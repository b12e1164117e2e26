"""Moments that can occur while operations run, against a search that takes one at a time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.behaviour import branch_states, joint_of
from pcmrs.fsm.blueprint import Blueprint, Condition, PropertySpec
from pcmrs.fsm.verify._liveness import TimedOperations
from pcmrs.fsm.verify._space import StateSpace
from tests.support.shipped import shipped_blueprint
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.moment_oracle import lengths, some_operations, stranded


@examples(40)
@given(blueprints(), st.data())
def test_finds_every_moment_on_its_level(blueprint: Blueprint, data: st.DataObject) -> None:
    check_moments(blueprint, some_operations(blueprint, data))


@pytest.mark.parametrize("other", ["digitization.digitize_all", "registration.use_previous", "placement.approach"])
def test_a_commit_waits_for_what_runs_on_a_branch_it_would_move(other: str) -> None:
    """A way home runs while a registration changes on which the standoff it began at rests: it can be concluded."""
    observed = frozenset({"placement.home", other})
    check_moments(shipped_blueprint("ratms"), observed)
    moments = TimedOperations(StateSpace(shipped_blueprint("ratms"), 100)).moments(observed)
    assert not any(moments.stranded(batch).any() for batch in moments.reached.batches())


def check_moments(blueprint: Blueprint, observed: frozenset[str]) -> None:
    """The moments of both searches are the same, and so are the lengths of the shortest ways to them."""
    moments = TimedOperations(StateSpace(blueprint, 10_000)).moments(observed)
    found = {
        (joint_of(blueprint, values), frozenset((name, locks) for name, locks in running)): length
        for length, level in enumerate(moments.reached.levels)
        for values, running in map(moments.decoded, level.tolist())
    }
    assert found == lengths(blueprint, observed)


@examples(40)
@given(blueprints(), st.data())
def test_conditions_hold_at_the_same_moments(blueprint: Blueprint, data: st.DataObject) -> None:
    observed = some_operations(blueprint, data)
    moments = TimedOperations(StateSpace(blueprint, 10_000)).moments(observed)
    branch = data.draw(st.sampled_from(list(blueprint.branches)))
    states = data.draw(st.lists(st.sampled_from(list(blueprint.branches[branch].states)), max_size=2))
    condition = Condition(states={branch: states}, running=sorted(observed))
    expected = sum(
        branch_states(blueprint, joint)[branch] in states and bool(running)
        for joint, running in lengths(blueprint, observed)
    )
    assert sum(int(moments.hold(condition, batch).sum()) for batch in moments.reached.batches()) == expected
    at_stop = sum(not stranded(blueprint, moment) for moment in lengths(blueprint, observed))
    stop = Condition(accepted=["stop"])
    assert sum(int(moments.hold(stop, batch).sum()) for batch in moments.reached.batches()) == at_stop


def test_an_operation_that_is_only_called_by_children_never_runs() -> None:
    runs = TimedOperations(StateSpace(shipped_blueprint("ratms"), 100))
    moments = runs.moments(frozenset({"registration.digitized"}))
    spec = PropertySpec(id="never", never=Condition(running=["registration.digitized"]))
    assert spec.never is not None
    assert not any(moments.hold(spec.never, batch).any() for batch in moments.reached.batches())
