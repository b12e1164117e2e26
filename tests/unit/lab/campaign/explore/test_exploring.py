"""Many sessions: every seed is run once, all is counted, and what was broken is shrunk, but not too much of it."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.testing.clock import ManualClock
from pcmrs_lab.campaign.explore import exploring
from pcmrs_lab.campaign.explore.exploring import AT_A_TIME, MOST_SHRUNK, Explored, as_lines, explore
from pcmrs_lab.campaign.explore.faults import FAULTS
from pcmrs_lab.campaign.explore.script import Act, SessionScript
from pcmrs_lab.campaign.explore.session import ExplorationResult
from tests.unit.lab.blueprints import ratms


class ScriptedSessions:
    """Sessions of ten seconds that cost one; those of some seeds are broken.

    Attributes:
        seeds: Seeds that were run, in order.
        broken: Seeds of broken sessions.
        shrunk: Seeds of scripts that were shrunk.
    """

    def __init__(self, clock: ManualClock) -> None:
        self.seeds: list[int] = []
        self.broken: set[int] = set()
        self.shrunk: list[int] = []
        self.clock = clock

    def run(self, script: SessionScript) -> ExplorationResult:
        self.seeds.append(script.seed)
        self.clock.stall(1.0)
        broken = script.seed in self.broken
        return ExplorationResult(
            seed=script.seed,
            time=10.0,
            cost=1.0,
            digest="",
            rows=1,
            reached={"occlude": 2},
            seen={"accepted robot.connect": 1, "accepted placement.home": script.seed},
            invariant="stop_holds" if broken else "",
            text="The arm moves." if broken else "",
            at=7.0 if broken else 0.0,
        )

    def shrink(self, script: SessionScript, fails: Any) -> SessionScript:
        before = len(self.seeds)
        assert fails(script)
        self.broken.discard(script.seed)
        assert not fails(script)
        del self.seeds[before:]
        self.shrunk.append(script.seed)
        return SessionScript(seed=script.seed, acts=script.acts[:1])


@pytest.fixture
def sessions(monkeypatch: pytest.MonkeyPatch) -> ScriptedSessions:
    clock = ManualClock()
    made = ScriptedSessions(clock)
    monkeypatch.setattr(exploring, "SystemClock", lambda: clock)
    monkeypatch.setattr(exploring, "run_session", made.run)
    monkeypatch.setattr(exploring, "shrink", made.shrink)
    workflow = type("Opened", (), {"blueprint": ratms()})()
    monkeypatch.setattr(exploring, "workflow_of", lambda _: workflow)
    return made


def test_every_seed_is_run_once_and_all_is_counted(sessions: ScriptedSessions) -> None:
    shown: list[tuple[str, int, int]] = []
    report = explore("ratms", 5, 6, progress=lambda *each: shown.append(each))
    assert sessions.seeds == list(range(5, 11))
    assert (report.sessions, report.simulated, report.cost, report.seconds) == (6, 60.0, 6.0, 6.0)
    assert report.rate == 10.0
    assert report.decisions == {"accepted placement.home": sum(range(5, 11)), "accepted robot.connect": 6}
    assert report.faults["occlude"] == 12
    assert "occlude" not in report.not_reached
    assert len(report.not_reached) == len(FAULTS) - 1
    assert shown == [("0 broken", done, 6) for done in range(1, 7)]


@pytest.mark.usefixtures("sessions")
def test_exploring_ends_when_its_time_is_over() -> None:
    report = explore("ratms", 1, None, minutes=0.15)
    assert report.sessions == 3 * AT_A_TIME, "what has begun is ended"


def test_no_session_is_a_report_of_none(sessions: ScriptedSessions) -> None:
    report = explore("ratms", 1, 0)
    assert (report.sessions, report.rate, report.broken) == (0, 0.0, [])
    assert sessions.seeds == []


def test_broken_sessions_are_shrunk_but_not_all_of_many(sessions: ScriptedSessions) -> None:
    sessions.broken = {2, 3, 5, 7, 8}
    report = explore("ratms", 1, 10)
    assert [each.seed for each in report.broken] == [2, 3, 5, 7, 8]
    assert sessions.shrunk == [2, 3, 5][:MOST_SHRUNK]
    assert [len(each.script.acts) for each in report.broken[:3]] == [1, 1, 1]
    assert all(len(each.script.acts) == each.acts > 1 for each in report.broken[3:])
    first = report.broken[0]
    assert (first.invariant, first.text, first.at) == ("stop_holds", "The arm moves.", 7.0)


def test_an_unknown_workflow_is_refused_before_any_session() -> None:
    with pytest.raises(ConfigurationError):
        explore("no_such_workflow", 1, 1)


def test_a_fault_that_no_session_injected_is_not_reached() -> None:
    report = Explored("ratms", "kinematic", 1, 1, 1.0, 1.0, 1.0, 1.0, {"occlude": 0, "e_stop": 2}, {}, [])
    assert report.not_reached == ["occlude"]


def test_a_script_is_shown_act_by_act() -> None:
    acts = [
        Act(0.5, "go_on", "anna", {"turn": 3}),
        Act(0.25, "stop", "ben", {}, True, "send:robot.*", 0.5),
        Act(0.0, "fault:occlude", "", {"body": "coil", "on": True}, window="write:device:*"),
        Act(0.0, "repeat"),
    ]
    assert as_lines(SessionScript(seed=1, acts=acts)) == [
        "  1. after 0.500 s anna: go_on turn=3",
        "  2. after 0.250 s into send:robot.*, held 0.500 s, ben: stop",
        "  3. after 0.000 s into write:device:*, fault:occlude body=coil on=True",
        "  4. after 0.000 s repeat",
    ]
