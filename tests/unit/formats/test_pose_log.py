"""Pose logs of a tracker: read sample by sample, or refused with file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcmrs.formats.pose_log import read_pose_log
from pcmrs.gateway.pose_files import sample_rows
from pcmrs.gateway.tracked_poses import TrackedPoses
from pcmrs.spatial import Transform, distance, rotation_angle
from tests.unit.formats.saved_poses import refusal_of, save

ROW = "0.056411,0.004691,0.083459,0.0,0.6,0.0,0.8"


def test_the_gateways_pose_log_is_read_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    seen = [TrackedPoses(*(Transform.from_rotvec(*rng.normal(size=(2, 3))) for _ in range(3))) for _ in range(5)]
    path = save(tmp_path, "".join(sample_rows(tracked) for tracked in seen), "poses_1.csv")
    log = read_pose_log(path)
    assert (log.name, log.samples) == ("poses_1", 5)
    for row, key in (
        ("body_tool", "image_from_tool"),
        ("pol_body", "tracker_from_image"),
        ("pol_tool", "tracker_from_tool"),
    ):
        for read, tracked in zip(log.poses[row], seen, strict=True):
            assert read is not None
            assert distance(read, getattr(tracked, key)) < 1e-6  # six decimals
            assert rotation_angle(read, getattr(tracked, key)) < 1e-5


@pytest.mark.parametrize(
    ("rows", "gaps"),
    [
        ("b o t b o t", {}),
        ("b o t b t b o t", {"pol_body": [1]}),
        ("b o b o t", {"pol_tool": [0]}),
        ("b o o t", {"body_tool": [1], "pol_tool": [0]}),
        ("t b o t", {"body_tool": [0], "pol_body": [0]}),
        ("b b b", {"pol_body": [0, 1, 2], "pol_tool": [0, 1, 2]}),
    ],
)
def test_missing_row_is_a_gap_in_its_sample_only(tmp_path: Path, rows: str, gaps: dict[str, list[int]]) -> None:
    names = {"b": "body_tool", "o": "pol_body", "t": "pol_tool"}
    log = read_pose_log(save(tmp_path, "\n".join(f"{names[row]},{ROW}" for row in rows.split()), "poses_1.csv"))
    found = {name: [index for index, pose in enumerate(poses) if pose is None] for name, poses in log.poses.items()}
    assert {name: missing for name, missing in found.items() if missing} == gaps


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty"),
        (f"body_tool,{ROW}\nbody,{ROW}\n", "line 2"),
        (f"body_tool,{ROW},1\n", "line 1"),
        (f"body_tool,{ROW}\npol_body,{ROW[:-3]}0.9\n", "line 2, pol_body"),
        (f"body_tool,{ROW[:-3]}east\n", "line 1, body_tool"),
        (f"body_tool,nan{ROW[8:]}\n", "line 1, body_tool"),
    ],
)
def test_invalid_pose_log_is_refused_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    assert said in refusal_of(save(tmp_path, text, "poses_1.csv"))


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "poses_1.csv"
    path.write_bytes(b"body_tool,\xff\xfe")
    assert "not CSV" in refusal_of(path)
