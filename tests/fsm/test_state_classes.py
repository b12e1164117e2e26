"""State Branches as classes: refuse in the base, allow in the state, one object each, one active."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ratms_oracle import BLUEPRINT

from pcmrs.errors import BlueprintError
from pcmrs.fsm import OperationSpec, State, StateSet, flags_of, load_blueprint
from pcmrs.fsm.closure import Denial

RATMS = load_blueprint(BLUEPRINT)


def every_state(states: StateSet) -> list[State]:
    return [state for objects in states.objects.values() for state in objects.values()]


def test_the_base_class_refuses_every_operation() -> None:
    for state in every_state(StateSet(RATMS)):
        (base,) = type(state).__bases__
        assert base.__bases__ == (State,)
        for operation in state.spec.operations:
            assert isinstance(getattr(base, operation)(state), Denial)


def test_a_state_class_overrides_exactly_what_is_valid_there() -> None:
    for state in every_state(StateSet(RATMS)):
        overridden = {name for name in vars(type(state)) if name in state.spec.operations}
        assert overridden == {name for name in state.spec.operations if state.spec.valid_in(name, state.name)}
        for name, spec in state.spec.operations.items():
            answer = state.ask(name)
            assert (answer is spec) if name in overridden else isinstance(answer, Denial)


def test_a_refusal_names_branch_state_and_operation() -> None:
    denial = StateSet(RATMS).active("registration").ask("register")
    assert isinstance(denial, Denial)
    assert denial.code == "invalid_in_state"
    assert denial.fields == {"branch": "registration", "state": "000", "operation": "register"}
    assert "no landmarks planned" in denial.text


def test_states_are_singletons_of_their_blueprint_only() -> None:
    one, other = StateSet(RATMS), StateSet(RATMS)
    before = one.objects["robot"]["1"]
    one.transition({"robot": "1"})
    assert one.active("robot") is before
    assert len({id(state) for state in every_state(one)}) == len({type(state) for state in every_state(one)})
    assert other.joint()["robot"] == "0"
    assert type(other.active("robot")) is not type(one.objects["robot"]["0"])


@given(
    st.lists(
        st.fixed_dictionaries(
            {}, optional={name: st.sampled_from(list(branch.states)) for name, branch in RATMS.branches.items()}
        )
    )
)
def test_exactly_one_state_of_each_branch_is_active_after_any_transitions(moves: list[dict[str, str]]) -> None:
    states, joint = StateSet(RATMS), RATMS.initial()
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
    assert flags_of(RATMS, joint) == {
        "landmarks_planned": True,
        "landmarks_digitized": True,
        "registered": False,
        "all_digitized": True,
        "pose_planned": False,
        "robot_connected": True,
    }


def test_allowed_lists_what_a_user_may_ask_for() -> None:
    assert StateSet(RATMS).objects["robot"]["1"].allowed() == ["disconnect", "acknowledge"]
    spec = RATMS.branches["robot"].operations["link_lost"]
    assert isinstance(spec, OperationSpec)
    assert spec.event
