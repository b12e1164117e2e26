"""`pcmrs calibrate hand-eye` on files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pcmrs.calibration import read_calibration
from pcmrs.calibration.poses import HAND_EYE, write_poses
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import distance
from tests.unit.cli.calibrate.calibrations import FLANGE_FROM_TOOL_MARKER, HOME, coil_seen, run


def hand_eye_file(folder: Path) -> str:
    rng, arm = np.random.default_rng(2), ArmModel(ARMS["iiwa14"])
    flange = [arm.forward(HOME + rng.uniform(-0.6, 0.6, 7)) for _ in range(15)]
    write_poses(folder / "hand_eye.csv", HAND_EYE, [flange, [coil_seen(pose) for pose in flange]])
    return str(folder / "hand_eye.csv")


def test_hand_eye_writes_a_tool(tmp_path: Path) -> None:
    output = tmp_path / "guide.toml"
    words = ("--type", "drill_guide", "--name", "guide", "--site", "or", "--cell", "2", "--valid-days", "7")
    ended = run("hand-eye", hand_eye_file(tmp_path), "-o", str(output), "--json", *words)
    assert ended.exit_code == 0, ended.output
    shown = json.loads(ended.stdout)["flange_from_tool_marker"]
    assert shown["position"] == pytest.approx([0.01, 0.02, 0.15], abs=1e-6)
    calibration = read_calibration(output)
    assert (calibration.type, calibration.cell, calibration.valid_days) == ("drill_guide", "or/2", 7)
    assert distance(calibration.transform(), FLANGE_FROM_TOOL_MARKER) < 1e-6
