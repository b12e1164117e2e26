"""The cell: its calibrations, devices and poses."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec
import pytest

from pcmrs.errors import ConfigurationError, RefusalError
from tests.unit.workflows.calibration_files import TIP, TODAY, TOOL, calibrated
from tests.unit.workflows.workflow_bench import LANDMARKS, WorkflowBench, open_bench


async def _explicit_id() -> str:
    async with open_bench() as bench:
        return bench.cell.calibration_id


async def test_nothing_is_known_of_the_arm_before_its_first_joints(bench: WorkflowBench) -> None:
    await bench.register()
    silent = replace(bench.cell, joints=None, base_from_body_ref=None)
    for ask in (silent.posture, partial(silent.frames, bench.data), partial(silent.image_from_coil, bench.data)):
        with pytest.raises(RefusalError, match="connect it first") as refused:
            ask()
        assert refused.value.refusal_code == "joints_unknown"


async def test_a_valid_file_takes_the_place_of_the_poses(tmp_path: Path) -> None:
    other_tip = msgspec.structs.replace(TIP, position=(0.0, 0.001, -0.15))
    async with open_bench(calibrated(tmp_path, "pointer", transforms={"pointer_from_tip": other_tip})) as bench:
        assert bench.cell.pointer_from_tip.translation.tolist() == [0.0, 0.001, -0.15]
        explicit_id = await _explicit_id()
        assert bench.cell.calibration_id != explicit_id
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        verdict = await bench.accept("digitization.digitize_one", index=0)
        assert verdict.result is not None
        assert verdict.result["calibration"] == {
            "tool": "explicit",
            "pointer": f"the pointer (version 1 of {TODAY:%Y-%m-%d})",
        }


async def test_a_tool_file_gives_the_coil_on_the_flange(tmp_path: Path) -> None:
    pose = msgspec.structs.replace(TOOL, position=(0.002, 0.0, 0.16))
    async with open_bench(calibrated(tmp_path, "tool", transforms={"flange_from_coil": pose})) as bench:
        cell = bench.cell
        assert cell.flange_from_coil.translation.tolist() == [0.002, 0.0, 0.16]
        assert (cell.flange_from_tool @ cell.tool_from_coil).matrix == pytest.approx(cell.flange_from_coil.matrix)


async def test_file_of_another_kind_is_a_bad_configuration(tmp_path: Path) -> None:
    """So is a file that cannot be read."""
    pointer = calibrated(tmp_path, "pointer")["calibration"]["pointer_file"]
    for file, words in ((pointer, "of a pointer"), (str(tmp_path / "none.toml"), "cannot be read")):
        with pytest.raises(ConfigurationError, match=words) as refused:
            async with open_bench({"calibration": {"tool_file": file}}):
                pass
        assert "procedure.calibration.tool_file" in refused.value.text
