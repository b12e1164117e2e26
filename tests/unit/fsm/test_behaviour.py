"""The closure of every operation in every reachable joint state, against an independent statement of it."""

from __future__ import annotations

import pytest

from pcmrs.errors import BlueprintError
from pcmrs.fsm import Closure, close
from pcmrs.fsm.behaviour import behaviour, endings, operations
from tests.support.ratms_oracle import (
    BRANCHES,
    EVENT_OPERATIONS,
    INTERNAL_OPERATIONS,
    MOTIONS,
    USER_OPERATIONS,
    Endings,
    Joint,
    all_operations,
    as_dict,
    expected,
    reachable,
)
from tests.support.shipped import shipped_blueprint

RATMS = shipped_blueprint("ratms")
REACHABLE = reachable()


def decided(joint: Joint, branch: str, operation: str) -> Endings | None:
    """What the product says, in the oracle's words."""
    states = as_dict(joint)
    if not RATMS.branches[branch].valid_in(operation, states[branch]):
        return None
    closure = close(RATMS, states, branch, operation)
    if not isinstance(closure, Closure):
        return None
    endings = {name: tuple(change.states.values()) for name, change in closure.outcomes.items()}
    endings["failed"] = tuple(closure.failure.states.values()) if closure.failure else joint
    endings["unknown"] = tuple(closure.unknown.states.values()) if closure.unknown else joint
    return endings  # type: ignore[return-value]


def test_blueprint_has_exactly_the_specified_operations() -> None:
    for branch in BRANCHES:
        declared = RATMS.branches[branch].operations
        known = [*USER_OPERATIONS[branch], *EVENT_OPERATIONS.get(branch, []), *INTERNAL_OPERATIONS.get(branch, [])]
        assert sorted(declared) == sorted(known)
        assert [n for n, spec in declared.items() if spec.event] == EVENT_OPERATIONS.get(branch, [])
        assert [n for n, spec in declared.items() if spec.iio] == INTERNAL_OPERATIONS.get(branch, [])
    assert [n for n, spec in RATMS.branches["placement"].operations.items() if spec.motion != "none"] == MOTIONS


def test_the_reachable_joint_states_are_the_40_of_the_oracle() -> None:
    found = set(behaviour(RATMS))
    assert found == set(REACHABLE)
    assert len(found) == 40


def test_registration_and_digitization_have_4_joint_states() -> None:
    assert {joint[:2] for joint in REACHABLE} == {("000", "0"), ("100", "0"), ("110", "1"), ("111", "1")}


@pytest.mark.parametrize(("branch", "operation"), all_operations())
def test_every_ending_leads_where_the_specification_says(branch: str, operation: str) -> None:
    for joint in REACHABLE:
        assert decided(joint, branch, operation) == expected(joint, branch, operation), joint


def test_too_many_joint_states_are_refused_with_the_limit() -> None:
    assert len(behaviour(RATMS, limit=40)) == 40
    with pytest.raises(BlueprintError, match="over 38 joint states") as refused:
        behaviour(RATMS, limit=38)
    assert refused.value.fields == {"limit": 38}


def test_only_an_operation_with_steps_can_fail_or_leave_doubt() -> None:
    states = RATMS.initial()
    for branch, operation, spec in operations(RATMS):
        closure = close(RATMS, states, branch, operation)
        if isinstance(closure, Closure):
            unconfirmed = {"failed", "unknown"} if spec.steps else set()
            assert endings(spec, closure).keys() == closure.outcomes.keys() | unconfirmed
