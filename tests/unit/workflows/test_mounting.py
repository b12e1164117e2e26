"""Calibrated poses of tool and pointer: from files or from the configuration, and never by omission."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import CalibrationSettings, WholePoseSetting
from pcmrs_sim.settings import GeometrySettings
from tests.unit.workflows.calibration_files import TRANSFORMS, calibrated, write

MARKER = WholePoseSetting((0.01, 0.0, 0.1), (0.0, 1.0, 0.0, 0.0))
TIP = WholePoseSetting((0.0, 0.02, -0.05), (0.5, 0.5, -0.5, 0.5))
IDENTITY: dict[str, Any] = {"position": [0, 0, 0], "quat_wxyz": [1, 0, 0, 0]}


def of(values: dict[str, Any]) -> Mounting:
    return Mounting.read(msgspec.convert(values["calibration"], CalibrationSettings))


def test_tip_is_the_marker_moved_by_the_calibrated_pose() -> None:
    mounting = Mounting.read(CalibrationSettings(flange_from_tool_marker=MARKER, tool_marker_from_tool_tip=TIP))
    expected = MARKER.transform().matrix @ TIP.transform().matrix
    np.testing.assert_allclose(mounting.flange_from_tool_tip.matrix, expected, atol=1e-15)
    np.testing.assert_allclose(mounting.tool_tip(MARKER.transform()).matrix, expected, atol=1e-15)
    assert mounting.tip_error == 0.0


def test_poses_by_default_are_those_of_the_simulated_tool() -> None:
    mounting, true = Mounting.read(CalibrationSettings()), GeometrySettings()
    np.testing.assert_allclose(
        mounting.flange_from_tool_tip.matrix, true.flange_from_tool_tip.transform.matrix, atol=1e-12
    )
    tip = true.tool_marker_from_tool_tip.transform
    np.testing.assert_array_equal(mounting.tool_marker_from_tool_tip.matrix, tip.matrix)
    assert np.linalg.norm(tip.translation) == pytest.approx(0.09)
    assert (np.abs(tip.rotvec) > 0.3).all(), "rotated about all axes"


def test_files_replace_the_poses(tmp_path: Path) -> None:
    pose = msgspec.structs.replace(TRANSFORMS["tool"]["flange_from_tool_marker"], position=(0.002, 0.0, 0.16))
    files = calibrated(tmp_path, "tool", transforms={"flange_from_tool_marker": pose})
    files["calibration"] |= calibrated(tmp_path, "pointer", error_mm=0.4)["calibration"]
    mounting = of(files)
    assert mounting.flange_from_tool_marker.translation.tolist() == [0.002, 0.0, 0.16]
    assert [*mounting.files] == ["tool", "tip", "pointer"]
    assert mounting.tip_error == pytest.approx(0.2e-3)
    assert mounting.identity != Mounting.read(CalibrationSettings()).identity


@pytest.mark.parametrize("kind", ["tool", "tip", "pointer"])
def test_each_calibration_is_part_of_the_identity(tmp_path: Path, kind: str) -> None:
    files = {"tool_file": write(tmp_path, "tool"), "tip_file": write(tmp_path, "tip")}
    files["pointer_file"] = write(tmp_path, "pointer")
    before = of({"calibration": files}).identity
    write(tmp_path, kind, valid_days=31)
    assert of({"calibration": files}).identity != before


def test_file_of_another_kind_is_a_bad_configuration(tmp_path: Path) -> None:
    """So is a file that cannot be read."""
    pointer, tip = write(tmp_path, "pointer"), write(tmp_path, "tip")
    for file, words in ((pointer, "of a pointer"), (str(tmp_path / "none.toml"), "cannot be read")):
        with pytest.raises(ConfigurationError, match=words) as refused:
            of({"calibration": {"tool_file": file, "tip_file": tip}})
        assert "procedure.calibration.tool_file" in refused.value.text


def test_files_of_two_tools_are_a_bad_configuration(tmp_path: Path) -> None:
    """Marker body and contact point are measured on the same tool, also if only one file names its serial number."""
    tool = write(tmp_path, "tool", serial="17")
    for serial in ("18", ""):
        tip = write(tmp_path, "tip", serial=serial)
        with pytest.raises(ConfigurationError, match="give two files of the same tool"):
            of({"calibration": {"tool_file": tool, "tip_file": tip}})
    assert of({"calibration": {"tool_file": tool, "tip_file": write(tmp_path, "tip", serial="17")}})


def test_marker_without_its_contact_point_is_refused(tmp_path: Path) -> None:
    """The text names the command that finds it. The identity counts only if it is written."""
    for given in ({"tool_file": write(tmp_path, "tool")}, {"flange_from_tool_marker": IDENTITY}):
        with pytest.raises(msgspec.ValidationError, match="pcmrs calibrate tip"):
            msgspec.convert(given, CalibrationSettings)
        explicit = msgspec.convert(given | {"tool_marker_from_tool_tip": IDENTITY}, CalibrationSettings)
        mounting = Mounting.read(explicit)
        np.testing.assert_array_equal(mounting.flange_from_tool_tip.matrix, mounting.flange_from_tool_marker.matrix)


def test_contact_point_without_its_marker_is_refused(tmp_path: Path) -> None:
    for given in ({"tip_file": write(tmp_path, "tip")}, {"tool_marker_from_tool_tip": IDENTITY}):
        with pytest.raises(msgspec.ValidationError, match="pcmrs calibrate hand-eye"):
            msgspec.convert(given, CalibrationSettings)


@pytest.mark.parametrize(
    "given",
    [
        {"tool_file": "a.toml", "flange_from_tool_marker": IDENTITY, "tip_file": "b.toml"},
        {"tool_file": "a.toml", "tip_file": "b.toml", "tool_marker_from_tool_tip": IDENTITY},
    ],
)
def test_a_pose_is_given_once(given: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError, match="both given"):
        msgspec.convert(given, CalibrationSettings)
