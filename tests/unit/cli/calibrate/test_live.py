"""`pcmrs calibrate --live` on a bus where a pointer is pivoted and an arm is moved."""

from __future__ import annotations

import asyncio
import json
import uuid
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcmrs.bus import Bus, BusSettings, Empty
from pcmrs.calibration import read_calibration
from pcmrs.calibration.poses import PIVOT, read_poses
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import BlueprintTag, BodyPose, JointState, Snapshot
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.testing.daemon import free_port
from tests.unit.cli.calibrate.calibrations import FLANGE_FROM_TOOL_MARKER, HOME, TIP, coil_seen, pivoted, run

REFERENCE = Transform.from_rotvec((0.2, 0.0, 1.5), (0.0, 0.3, 0.0))
FRAME = 1.0 / 60.0


class Cell:
    """A daemon that knows only its state, and devices that publish."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.words = ["--endpoint", bus.settings.endpoint, "--site", bus.settings.site, "--cell", bus.settings.cell]
        self._numbers = dict.fromkeys(("pointer", "coil", "body_ref"), 0)
        bus.serve("svc/snapshot", Empty, self._snapshot)

    async def _snapshot(self, _key: str, _asked: Empty) -> Snapshot:
        tag = BlueprintTag(id="test", version="1", hash="0")
        return Snapshot(sequence=1, branches={}, flags={}, running=[], latched=False, blueprint=tag)

    def show(self, body: str, pose: Transform, *, valid: bool = True) -> None:
        """One frame of the tracker."""
        self._numbers[body] += 1
        now = asyncio.get_running_loop().time()
        (x, y, z), (w, i, j, k) = pose.translation.tolist(), pose.quat_wxyz.tolist()
        frame = BodyPose(
            body=body,
            frame_number=self._numbers[body],
            captured=now,
            sent=now,
            valid=valid,
            position=(x, y, z),
            quat_wxyz=(w, i, j, k),
        )
        self.bus.publish(f"state/pose/{body}", frame)

    def report(self, positions: np.ndarray[Any, Any], velocity: float) -> None:
        """One state of the arm."""
        now = asyncio.get_running_loop().time()
        joints, velocities = positions.tolist(), [velocity] * len(positions)
        state = JointState(captured=now, sent=now, positions=joints, velocities=velocities, torques=[0.0] * len(joints))
        self.bus.publish("state/joints", state)


@asynccontextmanager
async def cell_with(act: Callable[[Cell], Any]) -> AsyncIterator[Cell]:
    """A cell on a bus of its own in which `act` goes on."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    bus = await Bus.open(BusSettings(mode="router", endpoint=endpoint, site="test", cell=f"c{uuid.uuid4().hex[:8]}"))
    try:
        cell = Cell(bus)
        acting = asyncio.create_task(act(cell))
        yield cell
        acting.cancel()
        with suppress(asyncio.CancelledError):
            await acting
    finally:
        await bus.close()


async def pivot_for_ever(cell: Cell) -> None:
    """A pointer tilted around on its tip, and hidden now and then."""
    rng, angle = np.random.default_rng(3), 0.0
    while True:
        angle += 0.1
        tilt = (0.6 * np.cos(angle), 0.6 * np.sin(angle) * np.cos(0.11 * angle))
        cell.show("pointer", pivoted(rng, tilt, 0.4 * np.sin(0.3 * angle)), valid=rng.random() > 0.1)
        await asyncio.sleep(FRAME)


async def test_a_pointer_is_calibrated_while_it_is_pivoted(tmp_path: Path) -> None:
    output, kept = tmp_path / "stylus.toml", tmp_path / "poses.csv"
    words = ("--live", "--poses", "30", "--seconds", "60", "--keep", str(kept), "-o", str(output), "--json")
    async with cell_with(pivot_for_ever) as cell:
        ended = await asyncio.to_thread(run, "pivot", *words, *cell.words)
    assert ended.exit_code == 0, ended.output
    assert "30 poses" in ended.stderr
    assert json.loads(ended.stdout)["tip_in_pointer"] == pytest.approx(TIP, abs=1e-4)
    calibration = read_calibration(output)
    assert calibration.transform().translation == pytest.approx(TIP, abs=1e-4)
    assert calibration.cell == f"test/{cell.bus.settings.cell}"
    assert len(read_poses(kept, PIVOT)[0]) >= 30


async def rest_for_ever(cell: Cell) -> None:
    rng = np.random.default_rng(3)
    while True:
        cell.show("pointer", pivoted(rng, (0.1, 0.2)))
        await asyncio.sleep(FRAME)


async def test_a_pointer_that_only_rests_is_no_calibration() -> None:
    async with cell_with(rest_for_ever) as cell:
        ended = await asyncio.to_thread(run, "pivot", "--live", "--seconds", "3", "--json", *cell.words)
    assert ended.exit_code == 1
    reason = json.loads(ended.stdout)["reason"]
    assert reason["code"] == "not_enough_poses"
    assert reason["fields"]["poses"] <= 1


async def move_for_ever(cell: Cell, pushed: float = 0.0) -> None:
    """An arm that moves to a posture, rests for a second, and moves on; the reference may be pushed on the way."""
    rng, arm, reference = np.random.default_rng(4), ArmModel(ARMS["iiwa14"]), REFERENCE
    while True:
        posture = HOME + rng.uniform(-0.6, 0.6, 7)
        for frame in range(70):
            moving = frame < 5
            joints = posture + (0.05 if moving else 0.0)
            cell.report(joints, 0.2 if moving else 0.0)
            # Without noise: of how many frames a mean is depends on the machine, and by chance one set of noisy poses
            # in a hundred loses one.
            cell.show("coil", coil_seen(arm.forward(joints)))
            cell.show("body_ref", reference)
            await asyncio.sleep(FRAME)
        reference = Transform.from_rotvec((pushed, 0.0, 0.0), (0.0,) * 3) @ reference


async def test_a_tool_is_calibrated_while_the_arm_is_moved(tmp_path: Path) -> None:
    output = tmp_path / "coil.toml"
    words = ("--live", "--poses", "6", "--seconds", "90", "-o", str(output), "--json")
    async with cell_with(move_for_ever) as cell:
        ended = await asyncio.to_thread(run, "hand-eye", *words, *cell.words)
    assert ended.exit_code == 0, ended.output
    found = read_calibration(output)
    assert distance(found.transform(), FLANGE_FROM_TOOL_MARKER) < 2e-4
    assert rotation_angle(found.transform(), FLANGE_FROM_TOOL_MARKER) < 2e-4
    assert json.loads(ended.stdout)["bad"] == []


async def test_a_pushed_reference_ends_the_calibration() -> None:
    async with cell_with(lambda cell: move_for_ever(cell, pushed=0.01)) as cell:
        ended = await asyncio.to_thread(run, "hand-eye", "--live", "--json", *cell.words)
    assert ended.exit_code == 1
    assert json.loads(ended.stdout)["reason"]["code"] == "reference_moved"


async def test_joints_of_another_arm_are_refused() -> None:
    async def report(cell: Cell) -> None:
        while True:
            cell.report(np.zeros(6), 0.0)
            await asyncio.sleep(FRAME)

    async with cell_with(report) as cell:
        ended = await asyncio.to_thread(run, "hand-eye", "--live", "--json", *cell.words)
    assert ended.exit_code == 1
    assert json.loads(ended.stdout)["reason"]["code"] == "other_robot"
