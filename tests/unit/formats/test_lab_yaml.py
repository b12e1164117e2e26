"""Landmarks and poses in the lab's YAML."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pcmrs.errors import FileFormatError
from pcmrs.formats.lab_text import lab_registration
from pcmrs.formats.lab_yaml import (
    lab_pose,
    read_lab_calibration,
    read_lab_cloud,
    read_lab_landmarks,
    read_lab_pose,
    read_refined,
)
from pcmrs.formats.reading import read_yaml
from pcmrs.spatial import Transform, distance, rotation_angle
from tests.unit.formats.landmark_files import check_refused, lab


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lab") / "reg.yaml"


@given(seed=st.integers(0, 2**32 - 1))
def test_a_registration_comes_back_as_it_was_written(seed: int, file: Path) -> None:
    rng = np.random.default_rng(seed)
    pose = Transform(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    file.write_text(lab_registration(pose, refined=bool(seed % 2)))
    found = lab_pose(read_yaml(file))
    assert distance(found, pose) < 1e-14
    assert rotation_angle(found, pose) < 1e-14
    assert f"FLAG_ICP: {seed % 2}" in file.read_text()


def test_braces_comments_and_short_numbers_are_read(file: Path) -> None:
    file.write_text(
        "TRANSLATION: # m\n\n  {\n  x: 1e-05, y: -2, # here\n  z: 0.5\n  }\nROTATION: {x: 0, y: 0, z: 1, w: 0}\n"
    )
    np.testing.assert_allclose(lab_pose(read_yaml(file)).translation, (1e-5, -2.0, 0.5))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("TRANSLATION: {x: 0, y: 0, z: 0}\n", "under ROTATION"),
        (
            "TRANSLATION: {x: 0, y: 0, z: .inf}\nROTATION: {x: 0, y: 0, z: 0, w: 1}\n",
            "no pose.*TRANSLATION|finite|number",
        ),
        ("TRANSLATION: {x: 0, y: 0, z: 0}\nROTATION: {x: 0, y: 0, z: 0, w: 2}\n", "length 2"),
        ("TRANSLATION: {x: 0, y: 0, z: 0, w: 1}\nROTATION: {x: 0, y: 0, z: 0, w: 1}\n", "x, y, z under TRANSLATION"),
    ],
)
def test_invalid_pose_is_refused(text: str, reason: str, file: Path) -> None:
    file.write_text(text)
    with pytest.raises(FileFormatError, match=reason) as caught:
        read_lab_pose(file)
    assert str(file) in caught.value.text


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.yaml", "", "holds no keys"),
        ("a.yaml", "NUM: 3\n", "PLANNED nor DIGITIZED"),
        ("a.yaml", "PLANNED: 5\n", "no braces.* PLANNED"),
        ("a.yaml", "PLANNED: {}\n", "no landmarks"),
        ("a.yaml", "PLANNED: {p0: {x: 1, y: 2}}\n", r"x, y, z under PLANNED\.p0, not x, y"),
        ("a.yaml", "PLANNED: {p0: {x: 1, y: 2, z: true}}\n", r"PLANNED\.p0 that is not a number"),
        ("a.yaml", "PLANNED: {p0: {x: 1, y: 2, z: far}}\n", r"PLANNED\.p0 that is not a number"),
        ("a.yaml", "DIGITIZED: {d0: {x: nan, y: nan, z: nan}}\n", "no point for landmark d0.*digitize"),
        ("a.yaml", lab(num=5), "NUM: 5, but PLANNED holds 3"),
        ("a.yaml", lab(names=("p0", "p1", "p0")), "p0 is given twice"),
        ("a.yaml", "PLANNED: {p0: {x: 1", "is not YAML"),
        ("a.yaml", "PLANNED: !!python/object/apply:os.getcwd []\n", "is not YAML"),
        ("a.yaml", "WHEN: 2024-13-40\n", "is not YAML"),
        ("a.yaml", "{" * 500, "is not YAML"),
    ],
)
def test_invalid_yaml_is_refused_with_file_and_reason(name: str, text: str, reason: str, tmp_path: Path) -> None:
    check_refused(tmp_path / name, text, reason)


CALIBRATION = "x: 0\ny: 0\nz: -0.15\nrx: 0\nry: 0\nrz: 0\nrw: 1\n"


@pytest.mark.parametrize(
    ("read", "text", "line", "reason"),
    [
        (read_lab_pose, "TRANSLATION: {x: 0, y: 0,\n  z: 0}\n\nROTATION: {x: 0,\n y: 0, z: 0, w: one}\n", 5, "w: one"),
        (read_lab_pose, "TRANSLATION: {x: 0, y: 0}\nROTATION: {x: 0, y: 0, z: 0, w: 1}\n", 1, "x, y, z under TRANSL"),
        (read_lab_pose, "ROTATION: {x: 0, y: 0, z: 0, w: 1}\nTRANSLATION: {x: 0, y: 0, z: 77.2}\n", 2, "77.2 m.*mm"),
        (read_lab_landmarks, "NUM: 1\nDIGITIZED:\n {\n d0: {x: 1, y: 2, z: far}\n }\n", 4, "z: far"),
        (read_lab_landmarks, "\n\nNUM: 2\nPLANNED: {p0: {x: 1, y: 2, z: 3}}\n", 3, "NUM: 2"),
        (read_lab_calibration, CALIBRATION.replace("z: -0.15", "z: -150.0"), 1, "150 m, the limit is 1 m.*not in mm"),
        (read_lab_calibration, CALIBRATION.replace("rw: 1", "rw: one"), 7, "rw: one"),
        (read_lab_calibration, CALIBRATION.replace("rw: 1", "rw: 2"), 4, "length 2"),
        (read_lab_calibration, CALIBRATION.replace("rw: 1\n", ""), 1, "needs .*rw, not x"),
        (read_lab_calibration, CALIBRATION + "unit: mm\n", 1, "not x, .*unit"),
        (read_lab_cloud, 'points0: "1,2,3,"\npoints1: "1,2,3,4,"\n', 2, "4 numbers under points1"),
        (read_lab_cloud, 'points0: "1,2,three,"\n', 1, "not a finite number"),
        (read_lab_cloud, 'points0: "1,2,nan,"\n', 1, "not a finite number"),
        (read_lab_cloud, "cloud: 5\n", 1, "a cloud is points0"),
        (read_refined, "FLAG_ICP: maybe\n", 1, "must be 0, or 1"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_line(
    read: Callable[[Path], object], text: str, line: int, reason: str, file: Path
) -> None:
    file.write_text(text)
    with pytest.raises(FileFormatError, match=reason) as caught:
        read(file)
    assert caught.value.text.startswith(f"{file} in line {line} ")
    assert caught.value.fields["line"] == line


def test_a_cleared_cloud_has_no_points(file: Path) -> None:
    file.write_text("")
    assert read_lab_cloud(file) == []
