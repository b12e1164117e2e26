"""A detector may call event operations only, with arguments that they take, and never one that moves."""

from __future__ import annotations

import re

import msgspec
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.scene.checks import check_scene_events
from pcmrs.scene.settings import SceneEventSettings, SceneRuleSettings, SceneSourceSettings
from tests.support.shipped import shipped_blueprint

RATMS = shipped_blueprint("ratms")


class Depth(msgspec.Struct, frozen=True):
    """Arguments of an event."""

    depth: float
    side: str = ""


class Nothing(msgspec.Struct, frozen=True):
    """No arguments."""


def with_payload(name: str) -> Blueprint:
    """RATMS, whose alignment event takes arguments."""
    branches = dict(RATMS.branches)
    alignment = branches["alignment"]
    outside = msgspec.structs.replace(alignment.operations["outside"], payload=name)
    branches["alignment"] = msgspec.structs.replace(alignment, operations=alignment.operations | {"outside": outside})
    return msgspec.structs.replace(RATMS, branches=branches)


def check(*rules: SceneRuleSettings, lost: str = "stop", payload: str = "none") -> None:
    settings = SceneEventSettings({"camera": SceneSourceSettings(when_lost=lost)}, rules)
    check_scene_events(settings, with_payload(payload), {"none": Nothing, "depth": Depth})


@pytest.mark.parametrize(
    ("calls", "text"),
    [
        ("placement.nowhere", "does not have"),
        ("alignment", "does not have"),
        ("placement.approach", "is for people"),
        ("robot.acknowledge", "is for people"),
        ("placement.home", "is for people"),
    ],
    ids=["unknown", "no_operation", "motion", "acknowledge", "retreat"],
)
def test_operation_that_no_detector_may_call_is_refused(calls: str, text: str) -> None:
    with pytest.raises(ConfigurationError, match=f"the rule for hand calls {re.escape(calls)}.*{text}"):
        check(SceneRuleSettings(label="hand", calls=calls))
    with pytest.raises(ConfigurationError, match=f"sources.camera.when_lost calls {re.escape(calls)}"):
        check(lost=calls)


@pytest.mark.parametrize("harm", ["moves", "affects_patient", "unlatches"])
def test_event_that_moves_treats_or_releases_is_refused(harm: str) -> None:
    alignment = RATMS.branches["alignment"]
    outside = msgspec.structs.replace(alignment.operations["outside"], **{harm: True})
    changed = msgspec.structs.replace(alignment, operations=alignment.operations | {"outside": outside})
    blueprint = msgspec.structs.replace(RATMS, branches=RATMS.branches | {"alignment": changed})
    rule = SceneRuleSettings(label="hand", calls="alignment.outside")
    settings = SceneEventSettings({"camera": SceneSourceSettings()}, (rule,))
    with pytest.raises(ConfigurationError, match="moves, treats or releases"):
        check_scene_events(settings, blueprint, {"none": Nothing})


def test_arguments_are_those_of_the_operation() -> None:
    check(SceneRuleSettings(label="hand", calls="alignment.outside", arguments=("depth",)), payload="depth")
    with pytest.raises(ConfigurationError, match="does not take speed; it takes depth, side"):
        check(SceneRuleSettings(label="hand", calls="alignment.outside", arguments=("depth", "speed")), payload="depth")
    with pytest.raises(ConfigurationError, match="needs depth"):
        check(SceneRuleSettings(label="hand", calls="alignment.outside"), payload="depth")


def test_states_of_a_stop_are_those_of_the_workflow() -> None:
    check(SceneRuleSettings(label="hand", states={"placement": ["standoff", "placed"]}))
    with pytest.raises(ConfigurationError, match="placement above"):
        check(SceneRuleSettings(label="hand", states={"placement": ["above"]}))
    with pytest.raises(ConfigurationError, match="no states"):
        check(SceneRuleSettings(label="hand", states={"nowhere": []}))


def test_events_and_reports_are_accepted() -> None:
    check(SceneRuleSettings(label="drift", calls="alignment.outside"), lost="alignment.outside")
    check(SceneRuleSettings(label="hand"), lost="report")
