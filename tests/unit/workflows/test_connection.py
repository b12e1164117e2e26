"""Connecting and locating the arm, and calibrations that must not be used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.fsm import Blueprint
from pcmrs.messages import JointState
from pcmrs.workflows import read_workflow
from tests.unit.workflows.calibration_files import TODAY, calibrated
from tests.unit.workflows.workflow_bench import LANDMARKS, WorkflowBench, open_bench

RESTING_ON_IT = {
    "registration.register",
    "registration.use_previous",
    "placement.approach",
    "placement.confirm",
    "digitization.digitize_all",
    "digitization.digitize_one",
    "digitization.reuse_previous_except",
    "registration.refine",
    "digitization.check_landmark",
    "digitization.digitize_surface",
}
WITH_A_COIL = {"placement.press", "placement.follow", "placement.guide"}


def _let_expire(bench: WorkflowBench) -> None:
    mounting = bench.cell.mounting
    old = msgspec.structs.replace(mounting.files["tool"], date=TODAY - timedelta(days=40))
    expired = msgspec.structs.replace(old, sha256=old.content_hash())
    bench.cell.mounting = replace(mounting, files={**mounting.files, "tool": expired})


async def test_locating_tells_near_from_clear() -> None:
    near = {"arm": {"home": [0.0, 0.35, 0.0, -1.5, 0.0, 1.2, -1.57]}}
    async with open_bench() as bench:
        await bench.connect()
        assert bench.states["placement"] == "retracted"
    async with open_bench({"placement": {"clearance": 2.0}}, near) as bench:
        await bench.connect()
        assert bench.states["placement"] == "held"
        assert (await bench.do("placement.home")).decision == "rejected"


async def test_locating_needs_the_tracker_to_see_tool_and_body(bench: WorkflowBench) -> None:
    await bench.scene.occlude("coil", True)
    await bench.clock.sleep(1.0)
    await bench.accept("robot.connect")
    await bench.until(lambda: any(verdict.operation == "locate" for verdict in bench.recorder.verdicts))
    located = bench.recorder.verdicts[-1]
    assert (located.decision, located.state) == ("failed", "unknown")
    assert bench.states["placement"] == "unknown"
    await bench.scene.occlude("coil", False)
    await bench.clock.sleep(0.2)
    assert (await bench.accept("placement.locate")).state == "retracted"


async def test_a_robot_that_does_not_answer_is_not_connected(bench: WorkflowBench) -> None:
    await bench.scene.cut_robot(True)
    verdict = await bench.do("robot.connect")
    assert verdict.decision == "unknown"
    assert bench.states["robot"] == "0"


async def test_robot_that_reports_joints_not_finite_is_not_connected(
    bench: WorkflowBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect, released = bench.robot.connect, list[bool]()

    async def broken() -> JointState:
        state = await connect()
        return msgspec.structs.replace(state, positions=[*state.positions[:-1], float("nan")])

    async def release(stopped: bool) -> list[str]:
        released.append(stopped)
        return []

    monkeypatch.setattr(bench.robot, "connect", broken)
    monkeypatch.setattr(bench.cell, "release", release)
    verdict = await bench.refuse("robot.connect", "bad_joints", "failed")
    assert verdict.reason is not None
    assert "nan" in verdict.reason.text
    assert (bench.states["robot"], bench.states["placement"], released) == ("0", "unknown", [])
    assert np.isfinite(bench.cell.posture()).all()
    monkeypatch.undo()
    await bench.connect()
    assert bench.states["placement"] == "retracted"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("ratms", RESTING_ON_IT | WITH_A_COIL),
        ("grid_mapping", RESTING_ON_IT | WITH_A_COIL),
        ("femoroplasty", RESTING_ON_IT),
    ],
)
def test_operations_that_need_a_calibration_check_it(name: str, expected: set[str]) -> None:
    blueprint: Blueprint = read_workflow(name)
    asking = {
        f"{branch}.{operation}"
        for branch, spec in blueprint.branches.items()
        for operation, found in spec.operations.items()
        if "calibration_valid" in found.checks
    }
    assert asking == expected


@pytest.mark.parametrize(
    ("kind", "given", "code"),
    [
        ("pointer", {"date": TODAY - timedelta(days=31)}, "calibration_expired"),
        ("tool", {"date": TODAY - timedelta(days=31)}, "calibration_expired"),
        ("tool", {"date": TODAY + timedelta(days=2)}, "calibration_in_future"),
        ("tool", {"type": "drill_guide"}, "calibration_foreign"),
        ("pointer", {"cell": "lab/cell2"}, "calibration_foreign"),
    ],
)
async def test_nothing_is_digitized_with_an_unusable_calibration(
    tmp_path: Path, kind: str, given: Mapping[str, Any], code: str
) -> None:
    async with open_bench(calibrated(tmp_path, kind, **given)) as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        verdict = await bench.refuse("digitization.digitize_all", code)
        assert verdict.reason is not None
        assert "calibrat" in verdict.reason.text
        await bench.refuse("digitization.digitize_one", code, index=0)
        await bench.accept("registration.clear_landmarks")


async def test_the_mounted_tool_must_be_the_calibrated_one(tmp_path: Path) -> None:
    procedure = calibrated(tmp_path, "tool", serial="17")
    procedure["calibration"]["tool_serial"] = "18"
    async with open_bench(procedure) as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.refuse("digitization.digitize_all", "calibration_foreign")


async def test_a_changed_file_is_refused(tmp_path: Path) -> None:
    procedure = calibrated(tmp_path, "pointer")
    file = tmp_path / "pointer.toml"
    file.write_text(file.read_text().replace("-0.15", "-0.16"))
    async with open_bench(procedure) as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.refuse("digitization.digitize_all", "calibration_changed")


async def test_expired_calibration_bars_approaches_but_no_retreat(tmp_path: Path) -> None:
    async with open_bench(calibrated(tmp_path, "tool")) as bench:
        await bench.to_standoff()
        _let_expire(bench)
        await bench.refuse("placement.confirm", "calibration_expired")
        await bench.refuse("registration.use_previous", "calibration_expired")
        await bench.accept("placement.home")
        await bench.refuse("placement.approach", "calibration_expired")


async def test_femoroplasty_needs_a_drill_guide(tmp_path: Path) -> None:
    async with open_bench(calibrated(tmp_path, "tool"), workflow="femoroplasty") as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.refuse("digitization.digitize_all", "calibration_foreign")
