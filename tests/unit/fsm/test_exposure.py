"""Where a patient is exposed: by what the blueprints of shipped, designed and hand-written workflows declare."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pcmrs.fsm import Blueprint
from pcmrs.fsm.blueprint import ActivitySpec
from pcmrs.fsm.exposure import Exposure
from tests.support.altered import with_operation
from tests.support.shipped import NAMES, shipped_blueprint
from tests.unit.fsm.exposure_workflows import BIOPSY, designed


def exposing(blueprint: Blueprint, branch: str, **others: str) -> set[str]:
    """States of a branch that expose the patient, while all other branches are in `others` or have just started."""
    exposure = Exposure(blueprint)
    joint = blueprint.initial() | others
    return {state for state in blueprint.branches[branch].states if exposure.holds(joint | {branch: state})}


@pytest.mark.parametrize("name", NAMES)
def test_the_tool_exposes_the_patient_where_it_is_at_the_body(name: str) -> None:
    blueprint = shipped_blueprint(name)
    away = {"unknown", "retracted", "held"}
    assert exposing(blueprint, "placement") == blueprint.branches["placement"].states.keys() - away


def test_armed_stimulator_exposes_anywhere_and_its_results_never() -> None:
    blueprint = shipped_blueprint("ratms_threshold")
    assert exposing(blueprint, "stimulation", placement="retracted") == {"armed"}
    for branch in ("hotspot", "threshold"):
        assert exposing(blueprint, branch, placement="retracted") == set()


def test_a_map_of_points_exposes_only_while_the_tool_is_there() -> None:
    blueprint = shipped_blueprint("grid_mapping")
    assert exposing(blueprint, "mapping", placement="retracted") == set()
    assert exposing(blueprint, "mapping", placement="placed") == blueprint.branches["mapping"].states.keys()


def test_a_designed_biopsy_exposes_until_it_is_made_safe() -> None:
    """The first digits are: registered, path planned, aligned, inserted, sampled."""
    blueprint = designed(BIOPSY.read_bytes())
    exposed = exposing(blueprint, "procedure")
    assert exposed == {state for state in blueprint.branches["procedure"].states if state[2] == "1"}
    made_safe = blueprint.branches["procedure"].operations["make_safe"].declared_targets()
    assert exposed.isdisjoint(made_safe)


def test_activity_exposes_if_it_moves_the_robot_or_treats() -> None:
    ratms = shipped_blueprint("ratms_threshold")

    def with_activity(branch: str, state: str, *, moves: bool) -> Blueprint:
        spec = ratms.branches[branch]
        activities = spec.activities | {state: ActivitySpec(run="act", ended="reinit", moves=moves)}
        branches = ratms.branches | {branch: msgspec.structs.replace(spec, activities=activities)}
        return msgspec.structs.replace(ratms, branches=branches)

    assert exposing(with_activity("threshold", "found", moves=False), "threshold") == {"found"}
    assert exposing(with_activity("toolplan", "1", moves=True), "toolplan") == {"1"}
    assert exposing(with_activity("toolplan", "1", moves=False), "toolplan") == set()


@pytest.mark.parametrize(
    ("declared", "exposed"),
    [
        ({"moves": True}, {"1"}),
        ({"motion": "retreat"}, set()),
        ({"affects_patient": True}, {"1"}),
        ({"affects_patient": True, "requires": {"placement": ["placed"]}}, set()),
        ({"affects_patient": True, "requires": {"registration": ["111"]}}, {"1"}),
    ],
)
def test_declarations_of_an_operation_decide_its_exposure(declared: dict[str, Any], exposed: set[str]) -> None:
    ratms = shipped_blueprint("ratms")
    assert exposing(with_operation(ratms, "toolplan", "plan", **declared), "toolplan") == exposed
