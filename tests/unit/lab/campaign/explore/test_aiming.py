"""An aimed session goes to a state by the procedure, and meets in windows that the cell has."""

from __future__ import annotations

import random
from fnmatch import fnmatchcase

import pytest

from pcmrs.gateway.commands import COMMANDS
from pcmrs.gateway.grammar import format_command
from pcmrs_lab.campaign.explore import aiming
from pcmrs_lab.campaign.explore.aiming import draw_aimed, draw_following
from pcmrs_lab.campaign.explore.faults import FAULTS
from pcmrs_lab.campaign.explore.script import Act
from tests.unit.lab.blueprints import ratms

SESSIONS = [draw_aimed(random.Random(seed)) for seed in range(150)]
ACTS = [act for acts in SESSIONS for act in acts]


def test_a_seed_always_draws_the_same_acts() -> None:
    assert draw_aimed(random.Random(3)) == SESSIONS[3] != SESSIONS[4]


def test_a_session_begins_with_the_procedure() -> None:
    steps = [Act(0.5, "go_on", "anna", {"turn": turn}) for turn in range(3)]
    ways = [next(number for number, act in enumerate(acts) if act not in steps) for acts in SESSIONS]
    assert set(ways) == set(aiming.DEPTHS)


def test_every_act_is_one_that_a_session_can_do() -> None:
    requestable = {f"{branch}.{name}" for branch, spec in ratms().branches.items() for name in spec.operations}
    for act in ACTS:
        kind, _, name = act.what.partition(":")
        if kind == "fault":
            assert name in FAULTS
        elif kind == "old":
            assert name in COMMANDS
            assert format_command(name, *act.arguments["tokens"])
        elif kind == "reuse":
            assert name in requestable
        else:
            assert act.what in {"go_on", "stop", *requestable}


def test_every_way_to_meet_is_drawn() -> None:
    what = {act.what for act in ACTS}
    assert {f"fault:{name}" for name in (*aiming.EVENTS, *aiming.ENDS, *aiming.SLOW)} <= what
    assert {f"old:{name}" for name, _ in aiming.OLD} <= what
    assert {name for name, _ in aiming.MOTIONS} <= what
    assert {"stop", "robot.acknowledge", *aiming.CHANGES} <= what
    assert {act.window for act in ACTS} == {"", *aiming.OF_OPERATIONS, *aiming.OF_STOPS}


def test_an_act_comes_while_its_window_is_open() -> None:
    within = [act for act in ACTS if act.window]
    assert len(within) > len(SESSIONS)
    assert all(0.0 <= act.after <= act.held <= aiming.LONGEST for act in within)
    longest = sum(act.held == aiming.LONGEST for act in within)
    assert longest / len(within) == pytest.approx(1.0 / 3.0, abs=0.1)


def test_a_fault_ends_soon() -> None:
    for act in (act for act in ACTS if act.what.startswith("fault:")):
        fault = FAULTS[act.what.removeprefix("fault:")]
        assert ("lasts" in act.arguments) == (fault.end is not None)
        assert act.arguments.get("lasts", 0.0) <= min(3.0, fault.lasts)


def test_the_first_act_of_an_interruption_is_in_the_window() -> None:
    acts = [Act(9.0, "stop", "ben"), Act(0.25, "go_on", "anna")]
    for seed in range(20):
        *held_up, first, second = aiming._inside(random.Random(seed), acts, aiming.OF_STOPS)
        inside = held_up[0] if held_up else first
        assert inside.window in aiming.OF_STOPS
        assert second == acts[1]
        assert (inside.what == "fault:held_up") == bool(held_up)


@pytest.mark.parametrize(
    ("name", "pattern"),
    [("send:robot.follow", "send:robot.*"), ("written:outcome:placement.approach", "written:outcome:*")],
)
def test_windows_are_patterns_of_names(name: str, pattern: str) -> None:
    assert pattern in aiming.OF_OPERATIONS
    assert fnmatchcase(name, pattern)


def test_sessions_follow_the_head_until_they_are_interrupted() -> None:
    sessions = [draw_following(random.Random(seed)) for seed in range(50)]
    for acts in sessions:
        assert [act.what for act in acts[: aiming.TO_FOLLOW + 1]] == ["go_on"] * aiming.TO_FOLLOW + ["placement.follow"]
        assert all(act.waits for act in acts[: aiming.TO_FOLLOW + 1])
        assert 0.0 <= acts[aiming.TO_FOLLOW + 1].after <= aiming.FOLLOWED
    interrupted = {acts[aiming.TO_FOLLOW + 1].what for acts in sessions}
    assert {"stop", "fault:crash_daemon", "fault:crash_node"} <= interrupted
