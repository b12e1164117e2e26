"""Timers begin with their state, end with it, and expire once."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.fsm.timers import TimerSchedule, duration
from tests.unit.fsm.timed_workflow import timed_blueprint

BLUEPRINT = timed_blueprint()
START = BLUEPRINT.initial()
PLACED = START | {"tool": "placed"}


def keys(timers: list) -> list[str]:  # type: ignore[type-arg]
    return [timer.key for timer in timers]


@pytest.fixture
def schedule() -> TimerSchedule:
    return TimerSchedule(BLUEPRINT, {})


def test_a_timer_begins_with_its_state_and_ends_with_it(schedule: TimerSchedule) -> None:
    assert schedule.follow(START, 0.0).begun == []
    assert keys(schedule.follow(PLACED, 10.0).begun) == ["tool.idle"]
    assert [timer.due for timer in schedule.running.values()] == [610.0]
    left = schedule.follow(START, 20.0)
    assert (keys(left.ended), schedule.next_due) == (["tool.idle"], None)


def test_a_command_that_keeps_the_state_lets_it_go_on(schedule: TimerSchedule) -> None:
    schedule.follow(PLACED, 10.0, "tool.place")
    changes = schedule.follow(PLACED, 50.0, "tool.look")
    assert (changes.begun, changes.ended, schedule.next_due) == ([], [], 610.0)


@pytest.mark.parametrize("operation", ["tool.nudge", "pulse.give"])
def test_a_command_that_restarts_it_begins_it_again(schedule: TimerSchedule, operation: str) -> None:
    schedule.follow(PLACED, 10.0)
    assert keys(schedule.follow(PLACED, 50.0, operation).begun) == ["tool.idle"]
    assert schedule.next_due == 650.0


def test_it_expires_once_until_it_begins_again(schedule: TimerSchedule) -> None:
    schedule.follow(PLACED, 0.0)
    assert schedule.expire(599.0) == []
    assert keys(schedule.expire(600.0)) == ["tool.idle"]
    assert (schedule.expire(5000.0), schedule.next_due) == ([], None)
    schedule.follow(PLACED, 5000.0, "tool.nudge")
    assert schedule.next_due == 5600.0


def test_one_that_repeats_begins_again_by_its_own_event(schedule: TimerSchedule) -> None:
    is_open = START | {"session": "open"}
    schedule.follow(is_open, 0.0)
    assert keys(schedule.expire(60.0)) == ["session.remind"]
    schedule.follow(is_open, 61.0, "session.reminded")
    assert schedule.next_due == 121.0


def test_after_a_long_pause_the_earliest_event_comes_first(schedule: TimerSchedule) -> None:
    schedule.follow(START | {"tool": "placed", "pulse": "resting"}, 0.0)
    assert keys(schedule.expire(10_000.0)) == ["pulse.rest", "tool.idle"]


def test_the_configuration_gives_the_time_of_a_limit() -> None:
    assert duration(BLUEPRINT, "pulse", "rest", {}) == 5.0
    assert duration(BLUEPRINT, "pulse", "rest", {"rest_s": 7.5}) == 7.5


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), 0.05])
def test_a_limit_that_is_no_time_is_refused(value: float) -> None:
    with pytest.raises(ConfigurationError, match=r"procedure\.limits\.rest_s.*0\.1"):
        TimerSchedule(BLUEPRINT, {"rest_s": value})


def test_a_limit_that_is_nowhere_is_refused() -> None:
    bare = msgspec.structs.replace(BLUEPRINT, defaults={})
    with pytest.raises(ConfigurationError, match=r"rest_s.*missing"):
        TimerSchedule(bare, {})
