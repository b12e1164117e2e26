"""The frames of a cell as one tree, from poses and joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcmrs.calibration import write_calibration
from pcmrs.errors import FileFormatError, GeometryError
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import PoseMessage
from pcmrs.recording.frame_tree import FrameTree, Mounting
from pcmrs.spatial import Transform
from pcmrs.workflows.settings import CalibrationSettings
from tests.unit.calibration.calibrations import a_pointer, a_tool
from tests.unit.recording.recording_bench import ARM, MOUNTING, joints


def test_frame_tree_joins_tracked_bodies_and_the_joints() -> None:
    """The coil by the joints must lie where the tracker saw it, when the arm stood: that is what joins the two."""

    home = np.array(ARM.home)
    seen = Transform.from_quat_wxyz((0.1, 0.2, 1.5), (0.5, 0.5, -0.5, 0.5))
    chain = FrameTree(ARM, MOUNTING)
    assert chain.coil(seen) is None  # the joints are not known yet
    chain.joints(joints(moving=True))
    assert chain.coil(seen) is None
    _, _, base_from_flange = chain.joints(joints())
    base = chain.coil(seen)
    assert base is not None
    links = {child: (parent, transform) for parent, child, transform in [*MOUNTING.links(), base]}
    links["flange"] = ("robot_base", base_from_flange)
    found, frame = Transform.identity(), "coil_by_robot"
    while frame != "tracker":
        parent, transform = links[frame]
        found, frame = transform @ found, parent
    np.testing.assert_allclose(found.matrix, seen.matrix, atol=1e-12)
    np.testing.assert_allclose(base_from_flange.matrix, ArmModel(ARM).forward(home).matrix, atol=1e-12)


def test_a_calibration_file_moves_the_coil_and_not_the_mount(tmp_path: Path) -> None:
    pose = PoseMessage(position=(0.002, 0.0, 0.16), quat_wxyz=(0.0, 1.0, 0.0, 0.0))
    tip = PoseMessage(position=(0.0, 0.001, -0.15), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
    write_calibration(tmp_path / "tool.toml", a_tool(transforms={"flange_from_coil": pose}))
    write_calibration(tmp_path / "pointer.toml", a_pointer(transforms={"pointer_from_tip": tip}))
    files = CalibrationSettings(tool_file=str(tmp_path / "tool.toml"), pointer_file=str(tmp_path / "pointer.toml"))
    mounting = Mounting.read(files)
    assert mounting.flange_from_coil.translation.tolist() == [0.002, 0.0, 0.16]
    assert mounting.pointer_from_tip.translation.tolist() == [0.0, 0.001, -0.15]
    np.testing.assert_array_equal(mounting.flange_from_tool.matrix, MOUNTING.flange_from_tool.matrix)
    links = {child: transform for _, child, transform in mounting.links()}
    np.testing.assert_allclose(
        (links["tool"] @ links["coil_by_robot"]).matrix, mounting.flange_from_coil.matrix, atol=1e-12
    )


def test_an_unreadable_calibration_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="cannot be read"):
        Mounting.read(CalibrationSettings(tool_file=str(tmp_path / "none.toml")))


def test_joints_of_another_arm_are_refused() -> None:
    with pytest.raises(GeometryError):
        FrameTree(ARM, MOUNTING).joints(joints([0.0] * 6))


def test_flange_of_a_standing_arm_is_computed_once() -> None:
    chain = FrameTree(ARM, MOUNTING)
    *_, first = chain.joints(joints())
    *_, again = chain.joints(joints())
    assert again is first
    *_, moved = chain.joints(joints([0.1] * 7))
    assert moved is not first
    *_, back = chain.joints(joints())
    np.testing.assert_array_equal(back.matrix, first.matrix)
