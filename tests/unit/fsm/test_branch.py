"""State objects of a running workflow: one for each state, exactly one of each branch active."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import BlueprintError
from pcmrs.fsm import (
    OperationSpec,
    State,
    StateSet,
    flags_of,
)
from pcmrs.fsm.classes import states_of
from tests.support.shipped import shipped_blueprint

RATMS = shipped_blueprint("ratms")


def every_state(states: StateSet) -> list[State]:
    return [state for objects in states.objects.values() for state in objects.values()]


def test_states_are_singletons_of_their_blueprint_only() -> None:
    one, other = StateSet(RATMS), StateSet(RATMS)
    before = one.objects["robot"]["1"]
    one.transition({"robot": "1"})
    assert one.active("robot") is before
    assert len({id(state) for state in every_state(one)}) == len({type(state) for state in every_state(one)})
    assert other.joint()["robot"] == "0"
    assert type(other.active("robot")) is not type(one.objects["robot"]["0"])


UNDER_TEST = StateSet(RATMS)


@given(
    st.lists(
        st.fixed_dictionaries(
            {}, optional={name: st.sampled_from(list(branch.states)) for name, branch in RATMS.branches.items()}
        )
    )
)
def test_one_state_per_branch_is_active_after_any_transitions(moves: list[dict[str, str]]) -> None:
    states, joint = UNDER_TEST, RATMS.initial()
    states.transition(joint)
    for targets in moves:
        states.transition(targets)
        joint |= targets
        assert states.joint() == joint
        for branch, objects in states.objects.items():
            assert [state for state in objects.values() if state.active] == [states.active(branch)]


def test_a_transition_to_nowhere_moves_nothing() -> None:
    states = StateSet(RATMS)
    with pytest.raises(KeyError):
        states.transition({"robot": "1", "registration": "101"})
    assert states.joint() == RATMS.initial()
    states.check_unique()


@pytest.mark.parametrize(("state", "active"), [("1", True), ("0", False)])
def test_corruption_is_detected(state: str, active: bool) -> None:
    states = StateSet(RATMS)
    states.objects["robot"][state].active = active
    with pytest.raises(BlueprintError, match=r"robot has \d active states"):
        states.check_unique()


def test_flags_mirror_the_digits() -> None:
    joint = {"registration": "110", "digitization": "1", "toolplan": "0", "robot": "1", "placement": "held"}
    joint |= {"alignment": "0", "teleoperation": "off"}
    assert flags_of(RATMS, joint) == {
        "landmarks_planned": True,
        "landmarks_digitized": True,
        "registered": False,
        "all_digitized": True,
        "pose_planned": False,
        "robot_connected": True,
        "aligned": False,
    }


def test_classes_that_contradict_the_blueprint_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    later = msgspec.structs.replace(RATMS, branches={"robot": RATMS.branches["robot"]})
    monkeypatch.setattr("pcmrs.fsm._branch.states_of", lambda _: states_of(RATMS))
    operations = later.branches["robot"].operations | {"connect": OperationSpec(from_=["0"], to="0")}
    changed = msgspec.structs.replace(later.branches["robot"], operations=operations)
    with pytest.raises(BlueprintError, match="robot 0 and the blueprint disagree on connect"):
        StateSet(msgspec.structs.replace(later, branches={"robot": changed}))
