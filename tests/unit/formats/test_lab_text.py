"""Texts of the lab's files: what the lab's modules and scripts read in them."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import yaml

from pcmrs.formats.lab_text import lab_calibration, lab_cloud, lab_digitized, lab_planned, lab_tool_pose
from pcmrs.formats.lab_yaml import read_lab_calibration, read_lab_cloud, read_lab_landmarks, read_lab_pose
from pcmrs.spatial import Transform, distance, rotation_angle

POINTS = ((-0.1615691632032394, 0.0274949, 0.003382), (0.01, -1e-05, 0.1))
POSE = Transform.from_rotvec((0.1, -0.2, 0.3), (0.4, -1.5, 0.6))


@pytest.mark.parametrize(
    ("hour", "stamp"),
    [(0, "20260102_120405AM"), (11, "20260102_110405AM"), (12, "20260102_120405PM"), (14, "20260102_020405PM")],
)
def test_a_plan_has_its_time_as_the_lab_writes_it(hour: int, stamp: str) -> None:
    content = yaml.safe_load(lab_planned(POINTS, datetime(2026, 1, 2, hour, 4, 5)))
    assert content["TIMESTAMP"] == stamp
    assert content["NUM"] == 2
    assert [[content["PLANNED"][f"p{index}"][axis] for axis in "xyz"] for index in range(2)] == [
        list(p) for p in POINTS
    ]


def test_an_open_landmark_is_not_a_number_for_scripts_and_for_us(tmp_path: Path) -> None:
    text = lab_digitized((POINTS[0], None))
    row = yaml.safe_load(text)["DIGITIZED"]["d1"]
    assert np.isnan([1000.0 * row[axis] for axis in "xyz"]).all(), "a module computes with it without an error"
    (tmp_path / "dig.yaml").write_text(text)
    (_, first), (_, second) = read_lab_landmarks(tmp_path / "dig.yaml")[0]
    assert first == POINTS[0]
    assert np.isnan(second).all()


def test_points_of_the_surface_are_numbers_with_commas(tmp_path: Path) -> None:
    text = lab_cloud(POINTS)
    # The lab's module takes all parts but the last, after the comma at the end.
    numbers = [float(part) for cloud in yaml.safe_load(text).values() for part in cloud.strip().split(",")[:-1]]
    np.testing.assert_allclose(np.reshape(numbers, (-1, 3)), POINTS, atol=1e-6)
    (tmp_path / "icpdig.yaml").write_text(text)
    np.testing.assert_allclose(read_lab_cloud(tmp_path / "icpdig.yaml"), POINTS, atol=1e-6)
    assert lab_cloud(()) == ""


def test_tool_pose_and_calibration_come_back(tmp_path: Path) -> None:
    (tmp_path / "toolpose.yaml").write_text(lab_tool_pose(POSE))
    (tmp_path / "a_b.yaml").write_text(lab_calibration(POSE))
    for found in (read_lab_pose(tmp_path / "toolpose.yaml"), read_lab_calibration(tmp_path / "a_b.yaml")):
        assert distance(found, POSE) < 1e-14
        assert rotation_angle(found, POSE) < 1e-14
