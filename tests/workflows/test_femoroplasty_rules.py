"""What is in the bone, and what may then happen: the blueprint against a memory of what the surgeon has said."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcmrs.fsm import Change, Closure, Denial, Engine
from pcmrs.fsm.files.sequence import expand
from pcmrs.workflows import read_workflow

BLUEPRINT = expand(read_workflow("femoroplasty"))
PLACED = {
    "registration": "111",
    "digitization": "1",
    "toolplan": "1",
    "robot": "1",
    "placement": "placed",
    "treatment": "ready",
}
MOTIONS = {name for name, spec in BLUEPRINT.branches["placement"].operations.items() if spec.motion != "none"}
IN_BONE = ("drilling", "injecting", "interrupted")
LEAVING = ("robot.disconnect", "registration.reinit", "toolplan.reinit", "placement.reinit", "treatment.reinit")
OPERATIONS = [
    (branch, name)
    for branch, spec in BLUEPRINT.branches.items()
    for name, operation in spec.operations.items()
    if not operation.iio
]
ENGINE = Engine(BLUEPRINT)
# Otherwise nine commands of ten lead away from the bone.
COMMANDS = st.sampled_from(OPERATIONS) | st.sampled_from([each for each in OPERATIONS if each[0] == "treatment"])


@dataclass
class Bone:
    """What has happened, by nothing but the commands that were accepted.

    Attributes:
        occupied: Drill or needle is in the bone.
        hole: There is a hole along the trajectory in force.
        checked: The guide has been measured and has not moved since.
        injected: There is cement in the hole.
        abandoned: The surgeon has given up.
    """

    occupied: bool = False
    hole: bool = False
    checked: bool = False
    injected: bool = False
    abandoned: bool = False

    def hear(self, branch: str, name: str, ending: str, change: Change) -> None:
        """Takes note of a command and of what it has changed."""
        if branch in ("registration", "toolplan") or change.moved & {"registration", "toolplan"}:
            self.hole = self.checked = False
        if branch == "placement" or "placement" in change.moved:
            self.checked = False
        if branch == "treatment":
            self._treat(name, ending)

    def _treat(self, name: str, ending: str) -> None:
        if ending in ("failed", "unknown"):
            self.checked = self.checked and name != "check_guide"
        elif name in ("start_drilling", "start_injection"):
            self.occupied = True
        elif name == "check_guide":
            self.checked = True
        elif name in ("confirm_drilled", "confirm_injected", "withdraw"):
            self.hole = self.hole or name == "confirm_drilled"
            self.occupied, self.checked, self.injected = False, False, name == "confirm_injected"
        elif name == "abandon":
            self.abandoned = True
        else:
            self.hole = self.checked = self.injected = self.abandoned = False


BEGINNINGS = {
    "ready": Bone(),
    "drilling": Bone(occupied=True),
    "drilled": Bone(hole=True),
    "checked": Bone(hole=True, checked=True),
    "injecting": Bone(occupied=True, hole=True),
}


def can_begin(name: str, bone: Bone) -> bool:
    """Whether the surgeon may go into the bone, by what has happened."""
    spent = bone.occupied or bone.injected or bone.abandoned
    return not spent and (not bone.hole if name == "start_drilling" else bone.hole and bone.checked)


@settings(max_examples=300)
@given(st.sampled_from(list(BEGINNINGS)), st.lists(st.tuples(COMMANDS, st.integers(0, 3)), max_size=30))
def test_the_states_never_pretend(beginning: str, commands: list[tuple[tuple[str, str], int]]) -> None:
    engine, bone = ENGINE, replace(BEGINNINGS[beginning])
    engine.place({**PLACED, "treatment": beginning})
    for (branch, name), choice in commands:
        answer = engine.ask(branch, name)
        if isinstance(answer, Denial):
            continue
        if (branch == "placement" and name in MOTIONS) or f"{branch}.{name}" in LEAVING:
            assert not bone.occupied, f"{branch}.{name} with something in the bone"
        if name in ("start_drilling", "start_injection"):
            assert can_begin(name, bone), f"{name} with {bone}"
        endings = [*answer.outcomes, "failed", "unknown"]
        ending = endings[choice % len(endings)]
        change = engine.perform(branch, name, ending)
        assert isinstance(change, Change)
        if change.effects or name == "check_guide":  # other failures leave everything as it was
            bone.hear(branch, name, ending, change)
        treatment = engine.joint()["treatment"]
        assert (treatment in IN_BONE) == bone.occupied
        assert engine.joint()["placement"] == "placed" or treatment not in ("drilling", "injecting")
        assert bone.hole or treatment not in ("drilled", "checked", "injecting")
        assert bone.checked or treatment != "checked"
        assert (treatment == "injected") == bone.injected
        assert not bone.occupied or isinstance(engine.ask("treatment", "withdraw"), Closure)


@pytest.mark.parametrize("treatment", IN_BONE)
@pytest.mark.parametrize("placement", ["placed", "held", "retracted", "unknown"])
def test_with_something_in_the_bone_nothing_moves_and_the_reason_is_clear(treatment: str, placement: str) -> None:
    engine = ENGINE
    engine.place({**PLACED, "placement": placement, "treatment": treatment})
    for name in MOTIONS:
        answer = engine.ask("placement", name)
        assert isinstance(answer, Denial)
        if placement in BLUEPRINT.branches["placement"].operations[name].from_ and name != "approach":
            assert answer.code == "drill_in_bone", name
    for name in LEAVING:
        answer = engine.ask(*name.split("."))
        assert isinstance(answer, Denial)
        assert f"it is in {treatment}" in answer.text


def test_the_work_goes_in_its_order_to_its_goal() -> None:
    engine = ENGINE
    engine.place(PLACED)
    for name, state in (
        ("start_drilling", "drilling"),
        ("confirm_drilled", "drilled"),
        ("check_guide", "checked"),
        ("start_injection", "injecting"),
        ("confirm_injected", "injected"),
    ):
        assert isinstance(engine.perform("treatment", name), Change)
        assert engine.joint() == {**PLACED, "treatment": state}
        assert isinstance(engine.ask("treatment", "start_injection"), Closure) == (state == "checked")
    assert engine.joint()["treatment"] in BLUEPRINT.goal["treatment"]


def test_every_word_of_the_surgeon_carries_a_name() -> None:
    operations = BLUEPRINT.branches["treatment"].operations
    without = {name for name, spec in operations.items() if spec.payload != "confirmation"}
    assert without == {"check_guide", "reinit"}
    assert all("record_confirmation" in spec.steps for name, spec in operations.items() if name not in without)
