"""State Branches as classes: refuse in the base, allow in the state, one object each, one active."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import BlueprintError
from pcmrs.fsm import (
    Blueprint,
    BranchSpec,
    Change,
    Closure,
    Denial,
    Engine,
    OperationSpec,
    State,
    StateSet,
    flags_of,
    load_blueprint,
)
from pcmrs.fsm.classes import source_of, states_of
from tests.support.ratms_oracle import BLUEPRINT

RATMS = load_blueprint(BLUEPRINT)


def every_state(states: StateSet) -> list[State]:
    return [state for objects in states.objects.values() for state in objects.values()]


def test_the_base_class_refuses_every_operation() -> None:
    for state in every_state(StateSet(RATMS)):
        (base,) = type(state).__bases__
        assert base.__bases__ == (State,)
        for operation in RATMS.branches[state.branch].operations:
            assert isinstance(getattr(base, operation)(state), Denial)


def test_a_state_class_overrides_exactly_what_is_valid_there() -> None:
    for state in every_state(StateSet(RATMS)):
        branch = RATMS.branches[state.branch]
        overridden = {name for name in vars(type(state)) if name in branch.operations}
        assert overridden == {name for name in branch.operations if branch.valid_in(name, state.name)}
        for name, spec in branch.operations.items():
            answer = state.ask(name)
            assert (answer == spec) if name in overridden else isinstance(answer, Denial)


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


def test_allowed_lists_what_a_user_may_ask_for() -> None:
    engine = Engine(RATMS)
    assert engine.allowed("robot") == ["connect"]
    assert engine.perform("robot", "connect")
    assert engine.allowed("robot") == ["disconnect", "acknowledge"]
    assert RATMS.branches["robot"].operations["link_lost"].event
    assert isinstance(engine.ask("robot", "link_lost"), Closure)


TEXTS = st.text() | st.sampled_from(
    ['"""', "\\", "'\n'", '"""\nimport os\n"""', "\\N{DIGIT ONE}", "{0}", "\u2028", "\x00"]
)


@given(TEXTS, TEXTS, TEXTS)
def test_texts_of_a_blueprint_are_only_texts_in_its_source(title: str, meaning: str, refusal: str) -> None:
    connect = OperationSpec(from_=["*"], to="1", refusal=refusal, title=title)
    branch = BranchSpec(title=title, states={"0": meaning, "1": title}, operations={"connect": connect})
    blueprint = Blueprint(id="texts", version="1", title=title, branches={"robot": branch})
    tree = ast.parse(source_of(blueprint))
    assert [type(node).__name__ for node in tree.body] == [
        "Expr",
        "ImportFrom",
        "ImportFrom",
        *["ClassDef"] * 3,
        "AnnAssign",
    ]
    kinds = states_of(blueprint)["robot"]
    assert [kind.meaning for kind in kinds] == [meaning, title]
    assert [kind().ask("connect") for kind in kinds] == [connect, connect]


def test_the_source_is_typed_and_formatted(tmp_path: Path) -> None:
    source = tmp_path / "ratms_states.py"
    source.write_text(source_of(RATMS))
    line_length = max(len(line) for line in source.read_text().splitlines())
    assert line_length <= 120
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", str(source)], capture_output=True, text=True, check=False
    )
    assert checked.returncode == 0, checked.stdout


def test_classes_that_contradict_the_blueprint_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    later = msgspec.structs.replace(RATMS, branches={"robot": RATMS.branches["robot"]})
    monkeypatch.setattr("pcmrs.fsm.branch.states_of", lambda _: states_of(RATMS))
    operations = later.branches["robot"].operations | {"connect": OperationSpec(from_=["0"], to="0")}
    changed = msgspec.structs.replace(later.branches["robot"], operations=operations)
    with pytest.raises(BlueprintError, match="robot 0 and the blueprint disagree on connect"):
        StateSet(msgspec.structs.replace(later, branches={"robot": changed}))


def test_state_classes_decide_also_in_a_cascade(monkeypatch: pytest.MonkeyPatch) -> None:
    """One path: were a class changed, the engine would do as the class says, not as the blueprint says."""
    monkeypatch.setattr(StateSet, "_check_answers", lambda *_: None)
    source = source_of(RATMS).replace(
        """    def digitized(self) -> Answer:
        return self.DIGITIZED""",
        """    def digitized(self) -> Answer:
        return self.UNDIGITIZED""",
    )
    monkeypatch.setattr("pcmrs.fsm.classes.source_of", lambda _: source)
    engine = Engine(RATMS)
    engine.perform("registration", "plan_landmarks")
    change = engine.perform("digitization", "digitize_all")
    assert isinstance(change, Change)
    assert [(e.kind, e.branch, e.target) for e in change.effects][:2] == [
        ("operation", "digitization", "1"),
        ("signal", "registration", "100"),
    ]
