"""Generated classes of branches and states: refused in the base, allowed in the state, and only text from texts."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm import (
    Blueprint,
    BranchSpec,
    Denial,
    OperationSpec,
    State,
    StateSet,
)
from pcmrs.fsm.classes import source_of, states_of
from tests.support.shipped import shipped_blueprint
from tests.unit.fsm.arm_workflow import arm_blueprint


def test_generated_class_names_the_activities() -> None:
    source = source_of(arm_blueprint())
    assert "# do / follow_head, which moves the robot; when that ends by itself, lost" in source
    assert "# do / watch_head; when that ends by itself, lost_sight" in source
    assert len(states_of(arm_blueprint())["arm"]) == 5


RATMS = shipped_blueprint("ratms")


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
