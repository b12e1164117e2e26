"""Evidence of a row: what makes it `not proved`, and the registry of ways to inject a fault."""

from __future__ import annotations

import math
from typing import Any

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.testing.needs import ROOT
from pcmrs_lab.campaign import fault as registry
from pcmrs_lab.campaign.catalogue import CLASSES, FaultClass
from pcmrs_lab.campaign.fault import DEADLINE, Evidence, fault
from pcmrs_lab.campaign.lab import Lab

SEEN = {"seen": 1}
NOTHING = [0, 0.0, "", None, False, [], {}, math.nan, math.inf, -math.inf]


def evidence(response: str = "held", **changed: Any) -> Evidence:
    """Complete evidence, but for what is changed."""
    complete: dict[str, Any] = {"took_place": SEEN, "control": SEEN, "control_kind": "permitted"}
    return Evidence(response, **{**complete, **changed})


@pytest.mark.parametrize("nothing", NOTHING, ids=repr)
def test_a_measurement_of_nothing_proves_nothing(nothing: Any) -> None:
    wrong = evidence(took_place={"seen": 1, "way_m": nothing})
    assert wrong.missing("sensor") == "The measurement that the fault took place is of nothing: way_m."
    uncontrolled = evidence(control={"way_m": nothing, "also": nothing})
    assert uncontrolled.missing("sensor") == "The measurement of its control is of nothing: way_m, also."


@pytest.mark.parametrize("something", [1, -0.1, "accepted", True, [0], {"a": 0}], ids=repr)
def test_any_measurement_of_fault_and_control_is_a_proof(something: Any) -> None:
    assert evidence(took_place={"x": something}, control={"y": something}).missing("sensor") == ""


def test_a_row_without_measurements_says_which_are_missing() -> None:
    unseen, uncontrolled = evidence(took_place={}, control={}), evidence(control={})
    assert unseen.missing("sensor") == "There is no measurement that the fault took place."
    assert uncontrolled.missing("sensor") == "There is no measurement of its control."


@pytest.mark.parametrize("response", ["", " \n"])
def test_a_row_without_a_response_proves_nothing(response: str) -> None:
    assert evidence(response).missing("sensor") == "There is no response."


@pytest.mark.parametrize("fault_class", CLASSES)
def test_input_from_people_and_attackers_needs_a_real_control(fault_class: FaultClass) -> None:
    """That a right input has its effect says nothing about a wrong one."""
    missing = evidence(control_kind="without_fault").missing(fault_class)
    if fault_class in ("operator", "adversary"):
        assert f"class {fault_class} must be the same input where it is permitted, or a mutant" in missing
    else:
        assert missing == ""
    for kind in ("permitted", "mutant"):
        assert evidence(control_kind=kind).missing(fault_class) == ""


def test_a_report_has_all_measurements() -> None:
    given = evidence(details={"rate_hz": 5.0}, control={"alone": "accepted"})
    assert given.measured == {
        "took_place": SEEN,
        "control": {"alone": "accepted"},
        "control_kind": "permitted",
        "rate_hz": 5.0,
    }


def test_nothing_is_registered_for_a_fault_that_does_not_exist() -> None:
    with pytest.raises(ConfigurationError, match="Z9"):
        fault("Z9", how="by magic")


def test_several_ways_are_kept_in_order_with_what_each_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "REGISTERED", {})

    @fault("S1", how="first")
    async def first(lab: Lab) -> Evidence:
        raise AssertionError

    @fault("S1", how="second", needs=[ROOT], deadline=9.0)
    async def second(lab: Lab) -> Evidence:
        raise AssertionError

    ways = registry.REGISTERED["S1"]
    assert [(way.name, way.how, way.needs, way.deadline) for way in ways] == [
        ("first", "first", (), DEADLINE),
        ("second", "second", (ROOT,), 9.0),
    ]
    assert ways[1].run is second
