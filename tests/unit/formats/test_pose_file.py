"""Saved placements: read as the lab and the gateway save them, or refused with file and key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pcmrs.errors import FileFormatError
from pcmrs.formats.pose_file import read_placements
from pcmrs.gateway.pose_files import placement_text
from pcmrs.spatial import Transform, distance, rotation_angle
from tests.unit.formats.saved_poses import refusal_of, save

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


def test_a_placement_is_read_as_the_lab_saves_it(tmp_path: Path) -> None:
    (placement,) = read_placements(save(tmp_path, AS_SAVED))
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
    path = save(tmp_path_factory.mktemp("saved"), placement_text(planned, measured))
    (placement,) = read_placements(path)
    for read, written in ((placement.planned, planned), (placement.measured, measured)):
        assert distance(read, written) < 1e-15
        assert rotation_angle(read, written) < 1e-14


def test_trials_are_in_numeric_order_and_other_files_are_skipped(tmp_path: Path) -> None:
    for number in (10, 2, 1):
        save(tmp_path, AS_SAVED, f"trial_{number}.yaml")
    save(tmp_path, "not a placement", "notes.txt")
    assert [placement.name for placement in read_placements(tmp_path)] == ["trial_1", "trial_2", "trial_10"]


def test_all_unreadable_files_of_a_folder_are_named(tmp_path: Path) -> None:
    save(tmp_path, AS_SAVED, "trial_1.yaml")
    broken, foreign = save(tmp_path, "{", "trial_2.yaml"), save(tmp_path, "NUM: 5", "trial_3.yml")
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
    assert said in refusal_of(save(tmp_path, AS_SAVED.replace(old, new)))


def test_a_folder_without_placements_is_refused(tmp_path: Path) -> None:
    assert "no saved placement" in refusal_of(tmp_path)
    assert "No such file" in refusal_of(tmp_path / "nowhere.yaml")
