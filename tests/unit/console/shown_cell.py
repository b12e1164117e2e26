"""Setup and poses of a cell, as the page shows it."""

from __future__ import annotations

import numpy as np

from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import BodyPose
from pcmrs.messages.setup import ArmShown, Setup
from pcmrs.spatial import Transform
from pcmrs.workflows.data import as_message

FLANGE_FROM_TOOL_TIP = Transform.from_rotvec((0.0, 0.01, 0.15), (3.1, 0.1, 0.0))
TOOL_MARKER_FROM_TOOL_TIP = Transform.from_rotvec((0.05, -0.03, 0.07), (0.4, 0.8, -0.6))


def shown(name: str) -> ArmShown:
    facts = find_arm(name)
    return ArmShown(
        name=name,
        joints=[as_message(each.parent_from_joint) for each in facts.joints],
        flange=as_message(facts.joint_from_flange),
        link_radius=facts.link_radius,
    )


def setup() -> Setup:
    return Setup(
        user="local", role="operator", lease_required=False, blueprint="", arm=shown("iiwa14"),
        flange_from_coil=as_message(FLANGE_FROM_TOOL_TIP),
        tool_marker_from_tool_tip=as_message(TOOL_MARKER_FROM_TOOL_TIP),
        tool_radius=0.05, tool_half_length=0.01, boxes=[], surface=None,
        patient="", operator="", residual_limit=0.004, drivers={},
    )  # fmt: skip


def body(name: str, pose: Transform, *, valid: bool = True) -> BodyPose:
    message = as_message(pose)
    return BodyPose(
        body=name, frame_number=1, captured=0.0, sent=0.0, valid=valid,
        position=message.position, quat_wxyz=message.quat_wxyz,
    )  # fmt: skip


def some_pose(seed: int) -> Transform:
    numbers = np.random.default_rng(seed).normal(size=6)
    return Transform.from_rotvec(numbers[:3], numbers[3:])
