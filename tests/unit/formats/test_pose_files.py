"""Saved placements and pose logs of other software: read as they are, or refused with file and place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pcmrs.errors import FileFormatError
from pcmrs.formats.pose_file import read_placements
from pcmrs.formats.pose_log import read_pose_log
from pcmrs.gateway.pose_files import placement_text, sample_rows
from pcmrs.spatial import Transform, distance, rotation_angle

# As the lab's software writes it: flow style inside a block, comments, numbers in fixed and scientific notation.
AS_SAVED = """\
PLANNED_POSE:
  {
    TRANSLATION: # translation: x,y,z
    {
      x: -0.0310000000000000,
      y: 0.0890000000000000,
      z: 1e-05
    },
    ROTATION: # quat: x,y,z,w
    {
      x: 0.0000000000000000,
      y: 0.7071067811865476,
      z: 0.0000000000000000,
      w: 0.7071067811865476
    }
  }
MEASURED_POSE:
  {
    TRANSLATION: {x: -0.0212, y: 0.0891, z: 0.0002},
    ROTATION: {x: 0.0, y: 0.7071, z: 0.0, w: 0.7071} # a few decimals only
  }
"""

ROW = "0.056411,0.004691,0.083459,0.0,0.6,0.0,0.8"


def _save(folder: Path, text: str, name: str = "trial_1.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def _refusal(path: Path) -> str:
    with pytest.raises(FileFormatError) as refusal:
        (read_pose_log if path.suffix == ".csv" else read_placements)(path)
    assert str(path) in refusal.value.text
    return refusal.value.text


def test_a_placement_is_read_as_the_lab_saves_it(tmp_path: Path) -> None:
    (placement,) = read_placements(_save(tmp_path, AS_SAVED))
    assert placement.name == "trial_1"
    assert placement.planned.translation.tolist() == [-0.031, 0.089, 1e-05]
    assert placement.planned.rotation @ (0.0, 0.0, 1.0) == pytest.approx([1.0, 0.0, 0.0])
    assert placement.measured.translation.tolist() == [-0.0212, 0.0891, 0.0002]
    assert rotation_angle(placement.measured, placement.planned) < 1e-9  # the short quaternion is normalized


finite = st.floats(-1.0, 1.0)


@given(arrays(float, 3, elements=finite), arrays(float, 3, elements=finite), arrays(float, 3, elements=finite))
def test_placement_saved_by_the_gateway_is_read_back(
    tmp_path_factory: pytest.TempPathFactory, position: np.ndarray, turn: np.ndarray, other: np.ndarray
) -> None:
    planned, measured = Transform.from_rotvec(position, turn), Transform.from_rotvec(other, -turn)
    path = _save(tmp_path_factory.mktemp("saved"), placement_text(planned, measured))
    (placement,) = read_placements(path)
    for read, written in ((placement.planned, planned), (placement.measured, measured)):
        assert distance(read, written) < 1e-15
        assert rotation_angle(read, written) < 1e-14


def test_trials_are_in_numeric_order_and_other_files_are_skipped(tmp_path: Path) -> None:
    for number in (10, 2, 1):
        _save(tmp_path, AS_SAVED, f"trial_{number}.yaml")
    _save(tmp_path, "not a placement", "notes.txt")
    assert [placement.name for placement in read_placements(tmp_path)] == ["trial_1", "trial_2", "trial_10"]


def test_all_unreadable_files_of_a_folder_are_named(tmp_path: Path) -> None:
    _save(tmp_path, AS_SAVED, "trial_1.yaml")
    broken, foreign = _save(tmp_path, "{", "trial_2.yaml"), _save(tmp_path, "NUM: 5", "trial_3.yml")
    with pytest.raises(FileFormatError) as refusal:
        read_placements(tmp_path)
    assert refusal.value.fields["files"] == [str(broken), str(foreign)]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("MEASURED_POSE", "MEASURED", "MEASURED_POSE"),
        ("w: 0.7071}", "w: 0.7100}", "MEASURED_POSE"),  # beyond one thousandth
        ("y: 0.0891, ", "", "MEASURED_POSE.TRANSLATION"),
        ("y: 0.0891", "y: above", "MEASURED_POSE.TRANSLATION"),
        ("y: 0.0891", "y: true", "MEASURED_POSE.TRANSLATION"),
        ("y: 0.0891", "y: .nan", "MEASURED_POSE"),
        ("TRANSLATION: {x: -0.0212, y: 0.0891, z: 0.0002}", "TRANSLATION: 5", "MEASURED_POSE.TRANSLATION"),
        (AS_SAVED, AS_SAVED + AS_SAVED, "twice"),  # a second trial appended would hide the first
        (AS_SAVED, "", "holds"),
        (AS_SAVED, "[" * 500, "YAML"),
    ],
)
def test_invalid_placement_is_refused_with_its_key(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in AS_SAVED
    assert said in _refusal(_save(tmp_path, AS_SAVED.replace(old, new)))


def test_a_folder_without_placements_is_refused(tmp_path: Path) -> None:
    assert "no saved placement" in _refusal(tmp_path)
    assert "No such file" in _refusal(tmp_path / "nowhere.yaml")


def test_the_gateways_pose_log_is_read_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    seen = [
        {
            key: Transform.from_rotvec(*rng.normal(size=(2, 3)))
            for key in ("body_from_tool", "tracker_from_body", "tracker_from_tool")
        }
        for _ in range(5)
    ]
    path = _save(tmp_path, "".join(sample_rows(tracked) for tracked in seen), "poses_1.csv")
    log = read_pose_log(path)
    assert (log.name, log.samples) == ("poses_1", 5)
    for row, key in (
        ("body_tool", "body_from_tool"),
        ("pol_body", "tracker_from_body"),
        ("pol_tool", "tracker_from_tool"),
    ):
        for read, tracked in zip(log.poses[row], seen, strict=True):
            assert read is not None
            assert distance(read, tracked[key]) < 1e-6  # six decimals
            assert rotation_angle(read, tracked[key]) < 1e-5


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
    log = read_pose_log(_save(tmp_path, "\n".join(f"{names[row]},{ROW}" for row in rows.split()), "poses_1.csv"))
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
    assert said in _refusal(_save(tmp_path, text, "poses_1.csv"))


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "poses_1.csv"
    path.write_bytes(b"body_tool,\xff\xfe")
    assert "not CSV" in _refusal(path)
