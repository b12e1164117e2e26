"""Files of poses: CSV and JSON, m and mm, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pcmrs.calibration.poses import HAND_EYE, PIVOT, header, read_poses, write_poses
from pcmrs.errors import FileFormatError
from pcmrs.spatial import Transform

POSES = [Transform.from_rotvec((0.1 * index, -0.2, 1.5), (0.0, 0.1 * index, 1.0)) for index in range(4)]


def test_written_file_is_read_back(tmp_path: Path) -> None:
    file = tmp_path / "poses.csv"
    write_poses(file, HAND_EYE, [POSES, POSES[::-1]])
    flange, coil = read_poses(file, HAND_EYE)
    for found, given in ((flange, POSES), (coil, POSES[::-1])):
        for one, other in zip(found, given, strict=True):
            assert one.matrix == pytest.approx(other.matrix, abs=1e-8)


def test_json_and_millimetres_and_other_columns(tmp_path: Path) -> None:
    file = tmp_path / "poses.json"
    names = header(PIVOT, "mm").split(",")
    row = dict(zip(names, (100.0, -200, "1500", 0, 0, 0, 1), strict=True)) | {"time": "12:00"}
    file.write_text(json.dumps([row]))
    ((pose,),) = read_poses(file, PIVOT)
    assert pose.translation == pytest.approx([0.1, -0.2, 1.5])
    assert np.array_equal(pose.rotation, np.eye(3))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no poses"),
        (header(PIVOT), "no poses"),
        ("x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,1", "has no pose tracker_from_pointer in row 1"),
        (header(PIVOT) + "\n0,0,0,0,0,0,1\n0,0,0,0,0,0", "row 2"),
        (header(PIVOT) + "\n0,0,left,0,0,0,1", "row 1"),
        (header(PIVOT) + "\n0,0,nan,0,0,0,1", "finite"),
        (header(PIVOT) + "\n0,0,0,0,0,0,2", "quaternion"),
        (header(PIVOT) + "\n0,0,1500,0,0,0,1", "in mm"),
    ],
)
def test_file_without_poses_is_refused_with_the_place(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "poses.csv"
    file.write_text(text)
    with pytest.raises(FileFormatError, match=words):
        read_poses(file, PIVOT)


@pytest.mark.parametrize("text", ["{", "{}", "[1]", "[" * 100_000])
def test_json_that_is_no_list_of_objects_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "poses.json"
    file.write_text(text)
    with pytest.raises(FileFormatError):
        read_poses(file, PIVOT)


def test_a_number_beyond_a_float_is_refused_with_its_row(tmp_path: Path) -> None:
    file = tmp_path / "poses.json"
    row = dict(zip(header(PIVOT).split(","), (10**400, 0, 0, 0, 0, 0, 1), strict=True))
    file.write_text(json.dumps([row]))
    with pytest.raises(FileFormatError, match="row 1"):
        read_poses(file, PIVOT)
