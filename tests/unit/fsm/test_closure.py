"""Properties of closures, over whatever sequence of commands."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm import Change, Closure, Denial, Effect, Engine, close, parse_blueprint
from pcmrs.fsm.behaviour import operations
from pcmrs.fsm.closure import MAX_EFFECTS
from tests.support.ratms_oracle import Joint, as_dict, reachable
from tests.support.shipped import shipped_blueprint
from tests.unit.fsm.level_workflow import THREE_LEVELS

RATMS = shipped_blueprint("ratms")

JOINTS: list[Joint] = reachable()


def changes_of(closure: Closure) -> list[Change]:
    return [*closure.outcomes.values(), *(c for c in (closure.failure, closure.unknown) if c is not None)]


def valid_in(states: dict[str, str]) -> list[tuple[str, str]]:
    """What anybody may ask for where the branches are in `states`."""
    return [
        (branch, operation)
        for branch, operation, spec in operations(RATMS)
        if not spec.iio and RATMS.branches[branch].valid_in(operation, states[branch])
    ]


@st.composite
def walks(draw: st.DrawFn) -> list[tuple[dict[str, str], Closure, Change]]:
    """A random sequence of allowed commands from the start, each with the ending it took."""
    states, taken = RATMS.initial(), []
    for _ in range(draw(st.integers(1, 20))):
        branch, operation = draw(st.sampled_from(valid_in(states)))
        closure = close(RATMS, states, branch, operation)
        if isinstance(closure, Denial):
            continue
        change = draw(st.sampled_from(changes_of(closure)))
        taken.append((states, closure, change))
        states = dict(change.states)
    return taken


@given(walks())
def test_children_always_fit_their_parents(walk: list[tuple[dict[str, str], Closure, Change]]) -> None:
    for _, _, change in walk:
        assert tuple(change.states.values()) in JOINTS
        for name, branch in RATMS.branches.items():
            if branch.parent is not None:
                assert change.states[branch.parent.branch] in branch.parent.compatible[change.states[name]]


@given(walks())
def test_effects_tell_the_whole_change_and_end(walk: list[tuple[dict[str, str], Closure, Change]]) -> None:
    for states, _, change in walk:
        replayed = dict(states)
        for effect in change.effects:
            assert replayed[effect.branch] == effect.source
            replayed[effect.branch] = effect.target
        assert replayed == change.states
        assert 1 <= len(change.effects) < MAX_EFFECTS


@given(walks())
def test_a_closure_locks_everything_it_moves(walk: list[tuple[dict[str, str], Closure, Change]]) -> None:
    for states, closure, _ in walk:
        assert not closure.writes & closure.reads
        for change in changes_of(closure):
            assert {branch for branch in states if states[branch] != change.states[branch]} <= closure.writes


@given(walks())
def test_child_change_signals_its_parent_unless_called_by_it(
    walk: list[tuple[dict[str, str], Closure, Change]],
) -> None:
    """Rule 2, and a re-initiation called by the parent emits nothing."""
    for _, _, change in walk:
        for number, effect in enumerate(change.effects):
            parent = RATMS.branches[effect.branch].parent
            if parent is None or effect.source == effect.target or effect.kind == "set":
                continue
            following = change.effects[number + 1 :][:1]
            signalled = bool(following) and (following[0].kind, following[0].branch) == ("signal", parent.branch)
            assert signalled == (effect.kind != "reinit")


@given(walks())
def test_a_tool_at_the_head_is_revoked_in_the_same_change(
    walk: list[tuple[dict[str, str], Closure, Change]],
) -> None:
    for states, _, change in walk:
        touched = [e for e in change.effects if e.branch in ("registration", "toolplan")]
        if states["placement"] in ("standoff", "placed", "following") and any(
            e.kind != "signal" or e.source != e.target for e in touched
        ):
            assert change.states["placement"] in ("held", "unknown", "replanned")
        if change.states["placement"] in ("standoff", "placed", "following"):
            assert (change.states["registration"], change.states["toolplan"]) == ("111", "1")


def outcome(joint: Joint, branch: str, operation: str) -> Change:
    closure = close(RATMS, as_dict(joint), branch, operation)
    assert isinstance(closure, Closure)
    return next(iter(closure.outcomes.values()))


def kinds(change: Change) -> list[tuple[str, str]]:
    return [(effect.kind, effect.branch) for effect in change.effects]


def test_an_echo_is_a_self_loop_and_locks_nothing() -> None:
    joint: Joint = ("110", "1", "0", "0", "unknown", "0", "off")
    change = outcome(joint, "digitization", "digitize_all")
    assert change.effects[-1] == Effect("signal", "registration", "digitized", "110", "110")
    assert change.states == as_dict(joint)
    assert change.moved == {"digitization"}


def test_a_parent_that_refuses_denies_the_command() -> None:
    """Fault 6: the check precedes every side effect."""
    denial = close(RATMS, RATMS.initial(), "digitization", "digitize_all")
    assert isinstance(denial, Denial)
    assert denial.code == "parent_refuses"
    assert denial.fields == {"branch": "registration", "state": "000", "operation": "digitized"}


def test_a_reinitiation_by_the_parent_emits_nothing() -> None:
    change = outcome(("110", "1", "0", "0", "unknown", "0", "off"), "registration", "clear_digitization")
    assert kinds(change) == [("operation", "registration"), ("reinit", "digitization")]


def test_a_signal_into_the_childs_start_does_not_reinitiate_it() -> None:
    change = outcome(("111", "1", "0", "0", "unknown", "0", "off"), "digitization", "redigitize_one")
    assert kinds(change) == [("operation", "digitization"), ("signal", "registration")]


def test_a_state_that_is_set_calls_no_operation() -> None:
    change = outcome(("000", "0", "0", "0", "unknown", "0", "off"), "registration", "use_previous")
    assert kinds(change) == [("operation", "registration"), ("set", "digitization")]


def test_a_lost_link_forgets_where_the_arm_is() -> None:
    change = outcome(("111", "1", "1", "1", "placed", "0", "off"), "robot", "link_lost")
    assert change.states["placement"] == "unknown"
    assert ("reinit", "placement") in kinds(change)


def test_an_acknowledgement_leaves_the_arm_where_it_is() -> None:
    joint: Joint = ("111", "1", "1", "1", "held", "0", "off")
    change = outcome(joint, "robot", "acknowledge")
    assert change.states == as_dict(joint)
    assert kinds(change) == [("operation", "robot")]


def test_a_denial_says_what_is_needed() -> None:
    denial: Any = close(RATMS, as_dict(("110", "1", "1", "1", "retracted", "0", "off")), "placement", "approach")
    assert denial.code == "requirement_not_met"
    assert denial.fields == {"branch": "registration", "state": "110", "needed": ["111"]}
    near: Any = close(RATMS, as_dict(("111", "1", "1", "1", "placed", "0", "off")), "robot", "disconnect")
    assert near.code == "tool_near_patient"


def test_a_state_that_is_set_takes_its_own_children_along() -> None:
    engine = Engine(parse_blueprint(THREE_LEVELS))
    for command in (("top", "enter"), ("mid", "step"), ("leaf", "step")):
        assert isinstance(engine.perform(*command), Change)
    change = engine.perform("top", "again")
    assert isinstance(change, Change)
    assert change.states == {"top": "b", "mid": "m0", "leaf": "l0", "watch": "quiet"}
    assert Effect("reinit", "leaf", "reinit", "l1", "l0") in change.effects


def test_a_revocation_takes_children_of_every_level_along() -> None:
    engine = Engine(parse_blueprint(THREE_LEVELS))
    for command in (("top", "enter"), ("mid", "step"), ("leaf", "step")):
        engine.perform(*command)
    change = engine.perform("watch", "shout")
    assert isinstance(change, Change)
    assert change.states == {"top": "a", "mid": "m0", "leaf": "l0", "watch": "loud"}


@pytest.mark.parametrize("placement", ["standoff", "placed", "replanned"])
def test_an_outcome_may_divert_a_revocation(placement: str) -> None:
    joint: Joint = ("111", "1", "1", "1", placement, "0", "off")
    closure = close(RATMS, as_dict(joint), "toolplan", "plan")
    assert isinstance(closure, Closure)
    assert {name: change.states["placement"] for name, change in closure.outcomes.items()} == {
        "planned": "held",
        "replanned": "replanned",
    }
    assert closure.writes >= {"toolplan", "placement"}


def test_a_diverted_revocation_of_nothing_changes_nothing() -> None:
    joint: Joint = ("111", "1", "1", "1", "retracted", "0", "off")
    closure = close(RATMS, as_dict(joint), "toolplan", "plan")
    assert isinstance(closure, Closure)
    assert closure.outcomes["replanned"].states == closure.outcomes["planned"].states == as_dict(joint)
    assert "placement" not in closure.writes
