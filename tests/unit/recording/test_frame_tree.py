"""The frames of a cell as one tree, from poses and joints."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.errors import GeometryError
from pcmrs.kinematics.model import ArmModel
from pcmrs.recording.frame_tree import FrameTree, fixed_links
from pcmrs.spatial import Transform
from tests.unit.recording.recording_bench import ARM, MOUNTING, joints


def test_frame_tree_joins_tracked_bodies_and_the_joints() -> None:
    """The marker body by the joints must lie where the tracker saw it, when the arm stood: that joins the two."""

    home = np.array(ARM.home)
    seen = Transform.from_quat_wxyz((0.1, 0.2, 1.5), (0.5, 0.5, -0.5, 0.5))
    chain = FrameTree(ARM, MOUNTING)
    assert chain.tool(seen) is None  # the joints are not known yet
    chain.joints(joints(moving=True))
    assert chain.tool(seen) is None
    _, _, base_from_flange = chain.joints(joints())
    base = chain.tool(seen)
    assert base is not None
    links = {child: (parent, transform) for parent, child, transform in [*fixed_links(MOUNTING), base]}
    links["flange"] = ("robot_base", base_from_flange)
    found, frame = Transform.identity(), "coil_by_robot"
    while frame != "tracker":
        parent, transform = links[frame]
        found, frame = transform @ found, parent
    np.testing.assert_allclose(found.matrix, seen.matrix, atol=1e-12)
    np.testing.assert_allclose(base_from_flange.matrix, ArmModel(ARM).forward(home).matrix, atol=1e-12)


def test_tip_hangs_at_the_tracked_marker_by_its_calibration() -> None:
    links = {child: (parent, transform) for parent, child, transform in fixed_links(MOUNTING)}
    assert {child: parent for child, (parent, _) in links.items()} == {
        "coil_by_robot": "flange",
        "tool_tip": "coil",
        "pointer_tip": "pointer",
    }
    tip = links["coil_by_robot"][1] @ links["tool_tip"][1]
    np.testing.assert_allclose(tip.matrix, MOUNTING.flange_from_tool_tip.matrix, atol=1e-12)


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
