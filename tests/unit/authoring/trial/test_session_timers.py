"""Simulated time: a wait lets timers expire in their order, and can be taken back."""

from __future__ import annotations

import pytest

from pcmrs.authoring.trial.session import MOST_EXPIRIES, SimulationSession
from pcmrs.errors import RefusalError
from tests.support.shipped import shipped_blueprint
from tests.unit.fsm.timed_workflow import timed_blueprint


@pytest.fixture
def walk() -> SimulationSession:
    return SimulationSession(timed_blueprint())


def told(walk: SimulationSession, seconds: float) -> list[tuple[float, str, str]]:
    return [(step.at, step.command, step.by) for step in walk.wait(seconds)]


def test_timers_expire_in_their_order(walk: SimulationSession) -> None:
    walk.ask("session.begin")
    walk.ask("tool.place")
    walk.ask("pulse.arm")
    walk.ask("pulse.give")
    assert told(walk, 70) == [
        (5.0, "pulse.rested", "pulse.rest"),
        (60.0, "session.reminded", "session.remind"),
        (70.0, "wait 10", ""),
    ]
    assert walk.steps[-1].timers == {"session.remind": 50.0, "tool.idle": 530.0}
    assert walk.steps[-1].lines() == ["timer session.remind: 50 s left", "timer tool.idle: 530 s left"]


def test_a_tool_that_is_left_alone_is_held(walk: SimulationSession) -> None:
    walk.ask("tool.place")
    assert told(walk, 600) == [(600.0, "tool.left_alone", "tool.idle")]
    assert walk.states()["tool"] == "held"
    assert walk.steps[-1].timers == {}


def test_a_restarted_timer_gets_its_whole_time(walk: SimulationSession) -> None:
    walk.ask("tool.place")
    walk.wait(500)
    assert walk.ask("tool.nudge").timers == {"tool.idle": 600.0}
    assert walk.ask("tool.look").timers == {"tool.idle": 600.0}


def test_waits_and_expiries_are_taken_back(walk: SimulationSession) -> None:
    walk.ask("tool.place")
    walk.wait(100)
    walk.wait(500)
    assert walk.states()["tool"] == "held"
    assert walk.undo()
    assert (walk.states()["tool"], walk.steps[-1].at) == ("placed", 100.0)
    assert told(walk, 500) == [(600.0, "tool.left_alone", "tool.idle")]
    walk.reset()
    assert told(walk, 1000) == [(1000.0, "wait 1000", "")]


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf")])
def test_what_is_no_time_is_refused(walk: SimulationSession, seconds: float) -> None:
    with pytest.raises(RefusalError, match="no time to wait"):
        walk.wait(seconds)


def test_a_wait_with_too_many_events_changes_nothing(walk: SimulationSession) -> None:
    walk.ask("session.begin")
    with pytest.raises(RefusalError, match=f"more than {MOST_EXPIRIES} times"):
        walk.wait(1e9)
    assert (len(walk.steps), walk.ask("tool.look").timers) == (1, {"session.remind": 60.0})


def test_without_timers_steps_have_no_time() -> None:
    walk = SimulationSession(shipped_blueprint("ratms"))
    walk.wait(10)
    step = walk.ask("robot.connect")
    assert (step.at, step.timers) == (0.0, {})
