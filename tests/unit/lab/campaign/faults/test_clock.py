"""Rows of the wall clock: whether it was set at all, and whether a motion that was disturbed shows anything of it."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import Any

import pytest

from pcmrs.bus.keys import command_key
from pcmrs.clock import SystemClock
from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import Reason
from pcmrs.planner import PlannerVerdict
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.faults import clock
from pcmrs_lab.campaign.faults.clock import DAY, HOUR, MOMENT
from pcmrs_lab.campaign.sham import sham
from pcmrs_lab.campaign.walltime import WallClock
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.scripted_client import verdict

NOW = 1.8e9
REINIT, ACKNOWLEDGE = command_key("local", "toolplan", "reinit"), command_key("local", "robot", "acknowledge")


@pytest.fixture(autouse=True)
def _now(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SystemClock, "wall", lambda _: NOW)


@pytest.mark.parametrize(
    ("ahead", "stamps", "is_set"),
    [
        (-HOUR, [NOW - 5, NOW - HOUR], True),
        (-HOUR, [NOW - 5, NOW], False),
        (-HOUR, [NOW - HOUR, NOW - HOUR], False),
        (10 * DAY, [NOW - 5, NOW + 10 * DAY - 59], True),
        (10 * DAY, [NOW - 5, NOW + 10 * DAY + 61], False),
        (None, [NOW - 5, NOW - 1, NOW - 1], True),
        (None, [NOW - 5, NOW - 1, NOW], False),
        (None, [NOW - 1], False),
    ],
)
def test_stamps_of_the_journal_show_how_the_clock_was_set(
    ahead: float | None, stamps: list[float], is_set: bool
) -> None:
    assert clock._is_set(stamps, ahead) is is_set


def held_for(code: str, seconds: Any) -> Any:
    return verdict(decision="failed", reason=Reason(code=code, text="It was late.", fields={"seconds": seconds}))


def test_a_motion_that_ended_as_usual_was_not_disturbed() -> None:
    clock._expect_undisturbed(verdict())


def test_a_busy_moment_shows_nothing_of_the_clock() -> None:
    with pytest.raises(NotRun, match="does too much else: It was late"):
        clock._expect_undisturbed(held_for("loop_stalled", MOMENT - 0.1))


@pytest.mark.parametrize("disturbed", [held_for("loop_stalled", HOUR), held_for("pose_stale", 0.1), held_for("x", "y")])
def test_a_motion_that_the_clock_ended_is_unmet(disturbed: Any) -> None:
    with pytest.raises(Unmet, match="was failed"):
        clock._expect_undisturbed(disturbed)


@pytest.mark.parametrize(("ahead", "call"), [(None, ("freeze",)), (-HOUR, ("shift", -HOUR))])
def test_a_clock_is_shifted_or_frozen(monkeypatch: pytest.MonkeyPatch, ahead: float | None, call: Any) -> None:
    done: list[Any] = []
    monkeypatch.setattr(WallClock, "freeze", lambda _: done.append(("freeze",)))
    monkeypatch.setattr(WallClock, "shift", lambda _, seconds: done.append(("shift", seconds)))
    clock._set(object.__new__(WallClock), ahead)
    assert done == [call]


async def test_a_decision_may_never_come() -> None:
    async def decided() -> Any:
        return verdict(decision="failed", code="late")

    async def lost() -> Any:
        raise UnknownOutcomeError("The client was asleep.")

    assert await clock._decision(decided()) == "failed"
    assert await clock._decision(lost()) == "no verdict"


def test_a_process_is_stopped_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not clock.is_stopped(os.getpid())
    assert not clock.is_stopped(1 << 30), "it has ended"
    monkeypatch.setattr(clock, "process_state", lambda _: "T")
    assert clock.is_stopped(os.getpid())


def fresh_only(cell: OperatedCell, *, believes: bool = False) -> None:
    """A daemon that refuses commands that are older or newer than their limit."""

    def decide(envelope: Any) -> Any:
        now = SimulatedClock(asyncio.get_running_loop()).wall()
        late = envelope.ttl is not None and envelope.sent is not None and abs(envelope.sent - now) > envelope.ttl
        code = "expired" if late and not believes else ""
        return verdict("toolplan.reinit", "rejected" if code else "accepted", code)

    cell.bus.answers[REINIT] = decide
    cell.bus.answers[ACKNOWLEDGE] = verdict("robot.acknowledge")


def test_only_commands_with_a_limit_look_at_the_clock(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = OperatedCell()
    fresh_only(cell)
    found = run(monkeypatch, clock.the_clocks_of_two_hosts_differ(lab_of(tmp_path, cell)))
    assert proves(found)
    assert len(found.took_place) == 4
    assert set(found.took_place.values()) == {"expired"}


def test_a_daemon_that_takes_an_old_command_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = OperatedCell()
    fresh_only(cell, believes=True)
    with pytest.raises(Unmet, match=r"-864000 s: accepted"):
        run(monkeypatch, clock.the_clocks_of_two_hosts_differ(lab_of(tmp_path, cell)))
    cell = OperatedCell()
    fresh_only(cell)
    with sham(), pytest.raises(Unmet, match=r"-864000 s: accepted"):
        run(monkeypatch, clock.the_clocks_of_two_hosts_differ(lab_of(tmp_path, cell)))


async def test_a_planner_that_is_refused_is_unmet() -> None:
    cell = OperatedCell()
    await clock._by_planner(cell.as_cell)
    cell.planner.verdicts["get_jnt_angsxxxx"] = PlannerVerdict("rejected", "robot", "0", "busy", ())
    with pytest.raises(Unmet, match="Over UDP it was rejected"):
        await clock._by_planner(cell.as_cell)
