"""After a Stop a person sees what was stopped, by whom, and what to check."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from pcmrs.console._stop_report import stop_report
from pcmrs.messages import BlueprintTag, DeviceEvent, Reason, Snapshot, StopState, UnknownOutcome, Verdict
from tests.support.shipped import shipped_blueprint

BLUEPRINT = shipped_blueprint("ratms_threshold")
LATCHED = Snapshot(
    sequence=1, branches=BLUEPRINT.initial(), flags={}, running=[], latched=True,
    blueprint=BlueprintTag(id="ratms_threshold", version="1", hash="0"), stop=StopState(number=7, confirmed=True),
)  # fmt: skip


def ended(branch: str, operation: str, text: str, decision: Any = "failed") -> Verdict:
    reason = Reason(code="stopped", text=text)
    return Verdict(
        id="1", branch=branch, operation=operation, decision=decision, state="held", sequence=1, reason=reason
    )


def pressed(number: int, by: str) -> DeviceEvent:
    return DeviceEvent(device=by, code="stopped", text=f"Stopped by {by}.", danger=True, fields={"stop": number})


def test_the_newest_stop_is_told_with_what_it_has_ended() -> None:
    events: list[Verdict | DeviceEvent] = [
        pressed(6, "bus:ben"),
        ended("placement", "home", "Stopped by bus:ben."),
        pressed(7, "bus:anna"),
        ended("placement", "approach", "Stopped by bus:anna."),
        ended("registration", "register", "Stopped by bus:anna.", "rejected"),
    ]
    report = stop_report(LATCHED, [(0.0, event) for event in events], BLUEPRINT)
    assert report is not None
    assert (report.number, report.by, report.why) == (7, "bus:anna", "Stopped by bus:anna.")
    assert report.stopped == ("placement.approach",)
    assert report.checks == ("check_arm", "check_cause")


def test_checks_follow_from_what_is_not_known() -> None:
    unknown = UnknownOutcome(command="1", source="bus:anna", branch="placement", operation="approach", since=0.0)
    shown = replace(LATCHED, stop=StopState(number=7), unknown=[unknown])
    events: list[tuple[float, Verdict | DeviceEvent]] = [
        (0.0, pressed(7, "robot")),
        (1.0, ended("stimulation", "fire", "Stopped by robot.", "unknown")),
    ]
    report = stop_report(shown, events, BLUEPRINT)
    assert report is not None
    assert report.checks == ("check_standstill", "check_arm", "check_patient", "check_unknown", "check_cause")


def test_a_stop_before_the_console_started_has_its_number() -> None:
    report = stop_report(LATCHED, [(0.0, ended("placement", "home", ""))], BLUEPRINT)
    assert report is not None
    assert (report.number, report.by, report.stopped) == (7, "", ())
    assert stop_report(replace(LATCHED, latched=False), [], BLUEPRINT) is None


def test_an_earlier_stop_of_the_same_user_is_not_reported() -> None:
    events: list[Verdict | DeviceEvent] = [
        pressed(6, "bus:anna"),
        ended("placement", "home", "Stopped by bus:anna."),
        pressed(7, "bus:anna"),
        ended("placement", "approach", "Stopped by bus:anna."),
    ]
    report = stop_report(LATCHED, [(0.0, event) for event in events], BLUEPRINT)
    assert report is not None
    assert report.stopped == ("placement.approach",)
