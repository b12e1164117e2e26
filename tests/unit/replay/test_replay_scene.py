"""A session whose scene was watched is decided again as it was, although a replay has no cameras."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.clock import SystemClock
from pcmrs.dispatcher import Dispatcher
from pcmrs.replay import ReplayReport
from pcmrs.replay._history import read_runs
from pcmrs.replay.replay import replay_runs
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs.testing.simulated import simulated_cell
from tests.support.shipped import shipped_workflow
from tests.unit.service.watches.test_scene import CAMERA, HAND, acknowledge, approach, detecting, prepare

OVERRIDES = (
    "sim.arm.physics=kinematic",
    CAMERA,
    f"scene_events.rules=[{HAND}, {{label='cable_out', calls='robot.link_lost'}}]",
)


async def watched_session(folder: Path) -> None:
    """A hand in an approach, motions that are refused, and an operation that a detector calls."""
    async with simulated_cell(folder, overrides=OVERRIDES) as cell, detecting(cell) as detector:
        await prepare(cell)
        moving = await approach(cell)
        detector.sees["hand"] = {}
        await moving
        await acknowledge(cell)
        await cell.accept("placement.back_off")
        for name in ("placement.confirm", "placement.approach"):
            assert (await cell.call(name)).decision == "rejected"
        detector.sees.clear()
        await cell.clock.sleep(1.0)
        await cell.accept("placement.home")
        await cell.accept("placement.approach")
        detector.sees["cable_out"] = {}
        await cell.until(lambda shown: shown.branches["robot"] == "0")


def decided_again(journal: Path) -> ReplayReport:
    return replay_runs(str(journal), read_runs(journal), lambda _: shipped_workflow("ratms"), SystemClock())


def test_watched_session_is_decided_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_on_simulated_loop(watched_session(tmp_path))
    journal = tmp_path / "journal.sqlite"
    rows = [stored.row for run in read_runs(journal) for stored in run.rows]
    codes = [row.verdict.reason.code for row in rows if row.verdict is not None and row.verdict.reason is not None]
    assert codes.count("scene_not_clear") == 2
    assert "detector:camera" in {row.source for row in rows}
    assert decided_again(journal).differences == []
    monkeypatch.setattr(Dispatcher, "bar_motion", lambda *_: None)
    assert decided_again(journal).differences
