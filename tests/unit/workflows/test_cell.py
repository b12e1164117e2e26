"""The cell: its calibrations, devices and poses."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest

from pcmrs.errors import RefusalError
from pcmrs.spatial import distance, rotation_angle
from pcmrs.workflows.data import as_transform
from tests.unit.workflows.calibration_files import TODAY, TRANSFORMS, calibrated
from tests.unit.workflows.workflow_bench import LANDMARKS, WorkflowBench, open_bench


async def _explicit_id() -> str:
    async with open_bench() as bench:
        return bench.cell.calibration_id


async def test_nothing_is_known_of_the_arm_before_its_first_joints(bench: WorkflowBench) -> None:
    await bench.register()
    silent = replace(bench.cell, joints=None, base_from_body_ref=None)
    for ask in (silent.posture, partial(silent.frames, bench.data), partial(silent.image_from_tool_tip, bench.data)):
        with pytest.raises(RefusalError, match="connect it first") as refused:
            ask()
        assert refused.value.refusal_code == "joints_unknown"


async def test_a_valid_file_takes_the_place_of_the_poses(tmp_path: Path) -> None:
    tip = TRANSFORMS["pointer"]["pointer_from_tip"]
    other_tip = msgspec.structs.replace(tip, position=(0.0, 0.001, -0.15))
    async with open_bench(calibrated(tmp_path, "pointer", transforms={"pointer_from_tip": other_tip})) as bench:
        assert bench.cell.pointer_from_tip.translation.tolist() == [0.0, 0.001, -0.15]
        explicit_id = await _explicit_id()
        assert bench.cell.calibration_id != explicit_id
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        verdict = await bench.accept("digitization.digitize_one", index=0)
        assert verdict.result is not None
        assert verdict.result["calibration"] == {
            "tool": "explicit",
            "tip": "explicit",
            "pointer": f"the pointer (version 1 of {TODAY:%Y-%m-%d})",
        }


async def test_tip_brought_to_the_target_is_truly_there(bench: WorkflowBench) -> None:
    """By the truth of the simulator, whose contact point is 90 mm from the marker body that its tracker sees."""
    await bench.to_placed()
    truth = await bench.scene.truth()
    registered, plan = bench.data.registered, bench.data.plan
    assert registered is not None
    assert plan is not None
    desired = as_transform(truth.tracker_from_body_ref) @ as_transform(registered.body_ref_from_image)
    desired = desired @ as_transform(plan)
    actual = as_transform(truth.tracker_from_coil)
    assert distance(desired, actual) < 1e-3
    assert rotation_angle(desired, actual) < np.radians(0.5)
    seen = bench.cell.poses.newest("coil")
    assert distance(seen, actual) == pytest.approx(0.09, abs=1e-3)
    assert rotation_angle(seen, actual) > 1.0
