"""Search in arrays against a search that takes one joint state at a time."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.behaviour import branch_states
from pcmrs.fsm.blueprint import Blueprint, Condition, PropertySpec
from pcmrs.fsm.verify import _search as search
from pcmrs.fsm.verify import verify
from pcmrs.fsm.verify._search import MAX_BITMAP, states_leading_to, visited
from pcmrs.fsm.verify._space import StateSpace
from tests.support.trials import examples
from tests.unit.fsm.large_blueprints import free
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.joint_state_oracle import levels, reachable_from


@examples(40)
@given(blueprints(), st.integers(1, 5), st.data())
@pytest.mark.nightly
def test_the_way_back_is_the_way_there(blueprint: Blueprint, batch: int, data: st.DataObject) -> None:
    """Also if the joint states are examined in many batches."""
    reached = levels(blueprint)
    goal = data.draw(st.sampled_from(list(reached)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "BATCH", batch)
        space = StateSpace(blueprint, 10_000)
        assert len(space.reached) == len(reached)
        code = space.encoding.code(branch_states(blueprint, goal))
        known = states_leading_to(space.reached, np.array([code]), space.leaving(space.all))
    for joint in reached:
        expected = goal in reachable_from(blueprint, joint)
        own = np.array([space.encoding.code(branch_states(blueprint, joint))])
        assert bool(known.has(own)[0]) == expected


@given(st.lists(st.lists(st.integers(0, 10**15)), max_size=30), st.booleans())
def test_a_set_of_codes_is_a_set(batches: list[list[int]], sparse: bool) -> None:
    modulus = 10**15 if sparse else 1000
    known, expected = visited(MAX_BITMAP + 1 if sparse else modulus), set[int]()
    for batch in batches:
        codes = [code % modulus for code in batch]
        new = known.add(np.array(codes, dtype=np.int64))
        assert new.tolist() == sorted(set(codes) - expected)
        expected |= set(codes)
        assert known.has(np.array(codes, dtype=np.int64)).all()


@pytest.mark.parametrize("count", [5, 6])
def test_all_searches_together_are_limited(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "MIN_BUDGET", 14_000)
    specs = [
        PropertySpec(id=f"p{n}", when=Condition(running=[f"b{n}.on"]), leads_to=Condition(states={"b7": ["s1"]}))
        for n in range(count)
    ]
    blueprint = msgspec.structs.replace(free(8, 2), properties=specs, goal={"b0": ["s0"]})
    found = [(finding.code, finding.text.partition(":")[0]) for finding in verify(blueprint, limit=300).findings]
    refused = ("too_many_states", "The properties watch too many joint states and running operations")
    assert found == ([refused] if count == 6 else [])
