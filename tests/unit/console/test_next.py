"""The large button says what is next and why, or what is missing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec

from pcmrs.console._choices import Choices
from pcmrs.console._next import NextButton, next_button, open_landmark
from pcmrs.console.planning.panel import NAMES as NAMES_OF_PLANS
from pcmrs.dispatcher.next_step import next_step
from pcmrs.fsm import guide_for
from pcmrs.messages import BlueprintTag, Running, Snapshot, StopState, TouchPrompt
from pcmrs.messages.setup import LandmarkShown, ProcedureDataView
from tests.support.shipped import shipped_blueprint
from tests.unit.console.detached_page import ENGLISH
from tests.unit.console.shown_cell import setup

BLUEPRINT = shipped_blueprint("ratms")
CHOICES = Choices(BLUEPRINT, ENGLISH)
NAMES = ("nose_tip", "left_eye", "right_eye", "left_ear", "right_ear", "chin")
REGISTERED = {"registration": "111", "digitization": "1", "toolplan": "1"}


def data(touched: int) -> ProcedureDataView:
    point = (0.0, 0.0, 0.1)
    return ProcedureDataView(
        landmarks=[
            LandmarkShown(name=name, planned=point, digitized=point if number < touched else None)
            for number, name in enumerate(NAMES)
        ]
    )


def shown(**states: str) -> Snapshot:
    return Snapshot(
        sequence=1, branches=BLUEPRINT.initial() | states, flags={}, running=[], latched=False,
        blueprint=BlueprintTag(id="ratms", version="1", hash="0"),
    )  # fmt: skip


def button(snapshot: Snapshot, touched: int = 0, why_not: str = "", **who: Any) -> NextButton:
    found = next_step(guide_for(BLUEPRINT), snapshot.branches, stop=snapshot.stop.number if snapshot.latched else None)
    choices = CHOICES.all(snapshot, msgspec.structs.replace(setup(), **who))
    if why_not:
        choices = {name: replace(each, why_not=why_not) for name, each in choices.items()}
    return next_button(found, snapshot, choices, data(touched), NAMES_OF_PLANS, ENGLISH)


def test_plans_are_made_on_the_surface() -> None:
    found = button(shown())
    assert (found.press, found.name, found.label, found.enabled) == (
        "plan", "registration.plan_landmarks", "Plan landmarks", True,
    )  # fmt: skip
    assert found.why == ENGLISH("next_why", stage="Plan the landmarks and the pose of the coil")


def test_the_next_landmark_is_named_and_sent() -> None:
    digitizing = shown(registration="100", toolplan="1")
    found = button(digitizing, touched=1)
    assert (found.label, found.arguments) == ("Touch 2 of 6: left eye", {"index": 1})
    prompt = TouchPrompt(text="Touch landmark 2 of 6", landmark="left_eye", number=2, count=6)
    touching = Running(branch="digitization", operation="digitize_one", id="1", prompt=prompt)
    running = msgspec.structs.replace(digitizing, running=[touching])
    found = button(running, touched=1)
    assert (found.press, found.meaning, found.why) == ("none", "", "Touch 2 of 6: left eye")
    assert open_landmark(data(len(NAMES))) is None


def test_the_same_label_for_another_landmark_is_another_meaning() -> None:
    digitizing = shown(registration="100", toolplan="1")
    assert button(digitizing, touched=1).meaning != button(digitizing, touched=2).meaning


def test_a_motion_is_marked_as_one() -> None:
    found = button(shown(**REGISTERED, robot="1", placement="retracted"))
    assert (found.name, found.moves, found.press) == ("placement.approach", True, "ask")


def test_what_is_missing_is_said_and_nothing_is_pressed() -> None:
    found = button(shown(**REGISTERED), role="planner")
    assert (found.name, found.enabled, found.meaning) == ("robot.connect", False, "")
    assert "planner" in found.why
    assert button(shown(), why_not="The cable is cut.").why == "The cable is cut."


def test_after_a_stop_the_release_names_it() -> None:
    stopped = msgspec.structs.replace(
        shown(**REGISTERED, robot="1", placement="held"), latched=True, stop=StopState(number=7, confirmed=True)
    )
    found = button(stopped)
    assert (found.label, found.arguments) == ("Release Stop 7", {"stop": 7})
    away = msgspec.structs.replace(stopped, branches=stopped.branches | {"robot": "0", "placement": "unknown"})
    assert (button(away).name, button(away).label) == ("robot.connect", "Connect")


def test_an_operation_that_runs_shows_its_progress() -> None:
    moving = shown(**REGISTERED, robot="1", placement="retracted")
    running = Running(branch="placement", operation="approach", id="1", progress=0.4)
    found = button(msgspec.structs.replace(moving, running=[running]))
    assert (found.label, found.why, found.enabled) == ("Please wait", "Approach: 40 %", False)
