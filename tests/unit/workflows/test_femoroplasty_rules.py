"""What is in the bone, and what may then happen: the blueprint against a memory of what the surgeon has said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm import Change, Closure, Denial, Engine
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.files.sequence import expand
from pcmrs.fsm.rules import check_rules
from pcmrs.fsm.verify import verify
from pcmrs.workflows import read_workflow
from tests.support.trials import examples

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
IN_BONE = ("drilling", "drilling_interrupted", "injecting", "injecting_interrupted")
LEAVING = ("robot.disconnect", "registration.reinit", "toolplan.reinit", "placement.reinit", "treatment.reinit")
PLANNING = [
    f"{branch}.{name}"
    for branch in ("registration", "digitization", "toolplan")
    for name, operation in BLUEPRINT.branches[branch].operations.items()
    if not operation.iio
]
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
        said: The surgeon has said that nothing is in the bone.
        occupied: Drill or needle is in the bone, as far as the surgeon has said.
        hole: There is a hole along the trajectory that was in force last.
        checked: The guide has been measured and has not moved since.
        lost: The plan or registration that the hole was drilled by has been changed since.
        injected: There is cement in the hole.
        abandoned: The surgeon has given up.
    """

    said: bool = True
    occupied: bool = False
    hole: bool = False
    checked: bool = False
    lost: bool = False
    injected: bool = False
    abandoned: bool = False

    def hear(self, branch: str, name: str, ending: str, change: Change) -> None:
        """Takes note of a command and of what it has changed."""
        if branch in ("registration", "toolplan") or change.moved & {"registration", "toolplan"}:
            self.checked, self.lost = False, self.lost or (self.hole and not self.injected)
        if branch == "placement" or "placement" in change.moved:
            self.checked = False
        if branch == "treatment":
            self._treat(name, ending)

    def _treat(self, name: str, ending: str) -> None:
        if ending in ("failed", "unknown"):
            self.checked = self.checked and name not in ("check_guide", "start_injection")
        elif name == "confirm_clear":
            self.said = True
        elif name in ("start_drilling", "start_injection"):
            self.occupied = True
        elif name == "check_guide":
            self.checked = True
        elif name in ("confirm_drilled", "confirm_injected", "withdraw"):
            self.hole = self.hole or name == "confirm_drilled"
            self.occupied, self.checked, self.injected = False, False, name == "confirm_injected"
        elif name == "abandon":
            self.abandoned, self.checked = True, False
        else:
            self.hole = self.checked = self.lost = self.injected = self.abandoned = False


BEGINNINGS = {
    "unknown": Bone(said=False),
    "ready": Bone(),
    "drilling": Bone(occupied=True),
    "drilled": Bone(hole=True),
    "checked": Bone(hole=True, checked=True),
    "injecting": Bone(occupied=True, hole=True),
}


def can_begin(name: str, bone: Bone) -> bool:
    """Whether the surgeon may go into the bone, by what has happened."""
    spent = bone.occupied or bone.lost or bone.injected or bone.abandoned or not bone.said
    return not spent and (not bone.hole if name == "start_drilling" else bone.hole and bone.checked)


def check_allowed(name: str, bone: Bone, toolplan: str) -> None:
    """What is accepted may be done, by what has happened."""
    branch, operation = name.split(".")
    if (branch == "placement" and operation in MOTIONS) or name in LEAVING:
        assert bone.said, f"{name} before anything is known of the bone"
        assert not bone.occupied, f"{name} with something in the bone"
    if name in PLANNING:
        assert not bone.occupied, f"{name} with something in the bone"
    if operation in ("start_drilling", "start_injection"):
        assert can_begin(operation, bone), f"{name} with {bone}"
    if name == "treatment.reinit":
        assert toolplan == "0", "a next trajectory while the last is in force"


def check_states(engine: Engine, bone: Bone) -> None:
    """The states say what has happened."""
    treatment = engine.joint()["treatment"]
    assert (treatment == "unknown") == (not bone.said)
    assert (treatment in IN_BONE) == bone.occupied
    assert engine.joint()["placement"] == "placed" or treatment not in ("drilling", "checked", "injecting")
    assert (treatment in ("drilled", "checked")) == (
        bone.hole and not (bone.occupied or bone.lost or bone.injected or bone.abandoned)
    )
    assert bone.hole or not treatment.startswith("inject")
    assert (treatment == "checked") <= bone.checked
    assert (treatment == "injected") == bone.injected
    if bone.occupied:
        assert isinstance(engine.ask("treatment", "withdraw"), Closure)
        done = "confirm_injected" if bone.hole else "confirm_drilled"
        assert isinstance(engine.ask("treatment", done), Closure), f"{done} in {treatment}"


@examples(300)
@given(st.sampled_from(list(BEGINNINGS)), st.lists(st.tuples(COMMANDS, st.integers(0, 3)), max_size=30))
def test_the_states_never_pretend(beginning: str, commands: list[tuple[tuple[str, str], int]]) -> None:
    engine, bone = ENGINE, replace(BEGINNINGS[beginning])
    engine.place({**PLACED, "treatment": beginning})
    check_commands(engine, bone, commands)


def check_commands(engine: Engine, bone: Bone, commands: list[tuple[tuple[str, str], int]]) -> None:
    """Gives commands, each to end as its number says, and checks what comes of them against the memory."""
    for (branch, name), choice in commands:
        answer = engine.ask(branch, name)
        if isinstance(answer, Denial):
            continue
        check_allowed(f"{branch}.{name}", bone, engine.joint()["toolplan"])
        unconfirmed = ("failed", "unknown") if BLUEPRINT.branches[branch].operations[name].steps else ()
        endings = [*answer.outcomes, *unconfirmed]
        ending = endings[choice % len(endings)]
        change = engine.perform(branch, name, ending)
        assert isinstance(change, Change)
        if change.effects:  # other failures leave everything as it was
            bone.hear(branch, name, ending, change)
        check_states(engine, bone)


Break = Callable[[dict[str, Any]], object]
"""Takes a promise of the blueprint away, given its branches."""


def _allow(name: str) -> Break:
    def change(branches: dict[str, Any]) -> None:
        branch, operation = name.split(".")
        branches[branch]["operations"][operation]["requires"]["treatment"] += IN_BONE

    return change


def _treatment(operation: str, **values: Any) -> Break:
    return lambda branches: branches["treatment"]["operations"][operation].update(values)


OUT_OF_BONE = ["ready", "drilled", "checked", "injected", "abandoned"]
BREAKS: dict[str, tuple[Break, str]] = {
    "motion after a restart": (
        lambda branches: branches["placement"]["operations"]["back_off"]["requires"]["treatment"].append("unknown"),
        "no_motion_in_bone",
    ),
    "retreat in the bone": (_allow("placement.home"), "no_motion_in_bone"),
    "disconnecting": (_allow("robot.disconnect"), "no_leaving_in_bone"),
    "registering": (_allow("registration.register"), "no_registration_in_bone"),
    "digitizing": (_allow("digitization.digitize_all"), "no_digitization_in_bone"),
    "planning": (_allow("toolplan.plan_trajectory"), "no_plan_change_in_bone"),
    "drilling after a restart": (
        _treatment("start_drilling", requires={}, refusal="x", **{"from": ["unknown", "ready"]}),
        "nothing_before_confirm_clear",
    ),
    "no word after a restart": (
        _treatment("confirm_clear", requires={"robot": ["0"]}),
        "confirm_clear_always_accepted",
    ),
    "the finished hole of an interruption": (
        _treatment("confirm_drilled", **{"from": ["drilling"]}),
        "drill_out_always_accepted",
    ),
    "the finished injection of an interruption": (
        _treatment("confirm_injected", **{"from": ["injecting"]}),
        "needle_out_always_accepted",
    ),
    "drilling twice": (
        _treatment("start_drilling", **{"from": ["ready", "drilled"]}),
        "no_hole_is_drilled_twice",
    ),
    "drilling after giving up": (
        _treatment("start_drilling", **{"from": ["ready", "abandoned"]}),
        "no_hole_is_drilled_twice",
    ),
    "injecting twice": (
        _treatment("check_guide", **{"from": ["drilled", "checked", "injected"]}),
        "no_hole_is_injected_twice",
    ),
    "a next trajectory along the last": (
        _treatment("reinit", requires={"treatment": OUT_OF_BONE}, refusal={"treatment": "drill_in_bone"}),
        "next_trajectory_without_the_last",
    ),
    "drilling beside the guide": (
        _treatment("start_drilling", requires={}, refusal="x"),
        "drilling_only_through_a_placed_guide",
    ),
    "injecting unchecked": (
        _treatment("start_injection", **{"from": ["drilled", "checked"]}),
        "injection_only_through_a_checked_guide",
    ),
    "no interruption": (
        lambda branches: branches["treatment"]["revocations"].__delitem__(slice(1, 3)),
        "work_only_through_a_placed_guide",
    ),
    "a hole of another plan": (lambda branches: branches["treatment"]["revocations"].pop(), "hole_only_along_the_plan"),
}
QUICK = "a hole of another plan"
"""All others are nightly."""


@pytest.mark.parametrize(
    ("change", "promise"),
    [
        pytest.param(*broken, marks=() if name == QUICK else pytest.mark.nightly, id=name)
        for name, broken in BREAKS.items()
    ],
)
def test_each_promise_is_proved_and_broken_by_what_breaks_it(change: Break, promise: str) -> None:
    table = msgspec.to_builtins(BLUEPRINT)
    table["properties"] = [each for each in table["properties"] if each["id"] == promise]
    assert not verify(msgspec.convert(table, Blueprint)).findings
    change(table["branches"])
    broken = msgspec.convert(table, Blueprint)
    assert not list(check_rules(broken))
    texts = [finding.text for finding in verify(broken).findings if finding.code == "property_violated"]
    assert [text.split()[0] for text in texts] == [promise]


@pytest.mark.parametrize("treatment", IN_BONE)
@pytest.mark.parametrize("placement", ["placed", "held", "retracted", "unknown"])
def test_anything_in_the_bone_bars_motion_with_a_clear_reason(treatment: str, placement: str) -> None:
    engine = ENGINE
    engine.place({**PLACED, "placement": placement, "treatment": treatment})
    for name in MOTIONS:
        answer = engine.ask("placement", name)
        assert isinstance(answer, Denial)
        if placement in BLUEPRINT.branches["placement"].operations[name].from_ and name != "approach":
            assert answer.code == "drill_in_bone", name
    for name in (*LEAVING, *PLANNING):
        branch, operation = name.split(".")
        answer = engine.ask(branch, operation)
        assert isinstance(answer, Denial), name
        if BLUEPRINT.branches[branch].valid_in(operation, engine.joint()[branch]):
            assert answer.code == "drill_in_bone", name
            assert f"it is in {treatment}" in answer.text


def test_unknown_bone_state_allows_planning_but_no_motion() -> None:
    engine = ENGINE
    engine.place({**PLACED, "placement": "held", "treatment": "unknown"})
    denied = {name for name in PLANNING if isinstance(engine.ask(*name.split(".")), Denial)}
    assert denied == {
        "registration.reinit",
        "toolplan.reinit",
        "digitization.digitize_one",
        "digitization.reuse_previous_of",
    }
    for name in ("placement.back_off", *LEAVING):
        answer = engine.ask(*name.split("."))
        assert isinstance(answer, Denial)
        assert answer.code == "drill_in_bone", name
    assert engine.allowed("treatment") == ["confirm_clear"]


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
    assert without == {"check_guide"}
    assert all("record_confirmation" in spec.steps for name, spec in operations.items() if name not in without)


def test_only_drilling_and_injecting_affect_the_patient() -> None:
    """Steps that report what was done do not."""
    operations = BLUEPRINT.branches["treatment"].operations
    assert {name for name, spec in operations.items() if spec.affects_patient} == {"start_drilling", "start_injection"}
