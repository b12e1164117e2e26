"""Reader of URDF documents: a serial chain of revolute joints from the root link to a flange, as facts of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, hypot, sin

import numpy as np

from pcmrs.kinematics._urdf_tree import MassProperties, UrdfJoint, UrdfTree, merge_bodies
from pcmrs.kinematics.arms import ArmFacts, JointFacts, Triple
from pcmrs.spatial import Floats, Transform

STIFFNESS = 2000.0
"""Joint stiffness of a simulated arm if none is given, N m/rad."""

_Z = np.array((0.0, 0.0, 1.0))
_FLANGES = ("tool0", "flange")  # in ROS-Industrial's order: +z points out of the arm in the first


def read_urdf(
    text: str,
    name: str,
    *,
    flange: str | None = None,
    home: Sequence[float] | None = None,
    stiffness: Sequence[float] | None = None,
) -> ArmFacts:
    """Read an arm from a URDF document. Everything mounted on its flange is left out, because our tool takes its place.

    Links on fixed joints merge with the link that carries them. Joints beside the chain stay at zero as if they were
    fixed. Every joint frame is turned so that the joint's axis is its z axis.

    Args:
        text: The URDF document.
        name: Name of the arm.
        flange: Link that carries the tool; by default ``tool0``, ``flange``, or the only link at an end.
        home: Posture in which the arm waits, rad, (n,); by default the middle of the joint ranges.
        stiffness: Joint stiffness of the simulated arm's impedance controller, N m/rad, (n,); `STIFFNESS` by default.

    Raises:
        ConfigurationError: The document describes no such chain, or lacks a limit or an inertia; the text names the
            joint.
    """
    tree = UrdfTree(text, name)
    tip = flange or _flange(tree)
    chain = tree.chain(tip)
    stops = {joint.name for joint in chain if joint.kind != "fixed"} | {joint.name for joint in tree.joints_on(tip)}
    joints, joint_from_link = [], Transform.identity()
    for joint in chain:
        joint_from_link = joint_from_link @ joint.parent_from_joint
        if joint.kind != "fixed":
            joint_from_axis = _turn_of_z_to(joint.axis)
            axis_from_joint = joint_from_axis.inverse()
            body = _body(tree, joint, axis_from_joint, stops)
            joints.append(_facts(tree, joint, joint_from_link @ joint_from_axis, body))
            joint_from_link = axis_from_joint
    if not joints:
        raise tree.error(f"no joint moves the link {tip}", "name the link that carries the tool tool0")
    return ArmFacts(
        name,
        tuple(joints),
        flange_xyz=_triple(joint_from_link.translation),
        flange_rpy=_rpy(joint_from_link.rotation),
        home=tuple(home or ((joint.lower + joint.upper) / 2.0 for joint in joints)),
        stiffness=tuple(stiffness or (STIFFNESS for _ in joints)),
    )


def _flange(tree: UrdfTree) -> str:
    for link in _FLANGES:
        if link in tree.links:
            return link
    ends = [link for link in tree.links if not tree.joints_on(link)]
    if len(ends) != 1:
        raise tree.error(f"it has the ends {', '.join(ends)}", "name the link that carries the tool tool0")
    return ends[0]


def _turn_of_z_to(axis: Floats) -> Transform:
    """Return the shortest rotation, as ``joint_from_axis``, that turns the z axis into the joint's axis."""
    sine = np.cross(_Z, axis)
    angle = atan2(float(np.linalg.norm(sine)), float(axis[2]))
    if not sine.any():
        return Transform.from_rotvec(np.zeros(3), (angle, 0.0, 0.0))  # 0, or half a turn about any axis
    return Transform.from_rotvec(np.zeros(3), angle * sine / np.linalg.norm(sine))


def _body(tree: UrdfTree, joint: UrdfJoint, axis_from_joint: Transform, stops: set[str]) -> MassProperties:
    """Return everything that moves with a joint but not with the next one, in the joint's turned frame."""
    bodies = [body.expressed_in(axis_from_joint) for body in tree.bodies_on(joint.child, stops)]
    if sum(body.mass for body in bodies) <= 0.0:
        raise tree.error(f"the joint {joint.name} moves a link without mass", "give its link an inertial element")
    return merge_bodies(bodies)


def _facts(tree: UrdfTree, joint: UrdfJoint, parent_from_joint: Transform, body: MassProperties) -> JointFacts:
    if joint.kind != "revolute":
        raise tree.error(f"the joint {joint.name} is {joint.kind}", "only arms of revolute joints with limits are used")
    lower, upper, velocity, effort = tree.limits(joint)
    xx, yy, zz = body.inertia.diagonal().tolist()
    inertia = (xx, yy, zz, float(body.inertia[0, 1]), float(body.inertia[0, 2]), float(body.inertia[1, 2]))
    xyz, rpy = _triple(parent_from_joint.translation), _rpy(parent_from_joint.rotation)
    return JointFacts(joint.name, xyz, rpy, lower, upper, velocity, effort, body.mass, _triple(body.com), inertia)


def _rpy(rotation: Floats) -> Triple:
    """Return fixed-axis roll, pitch and yaw of a rotation, rad; exact also if roll and yaw turn about one axis.

    Yaw is computed first, and roll from the remaining rotation. (G. Slabaugh, Computing Euler Angles from a Rotation
    Matrix, 1999, treats the degenerate case separately instead.)
    """
    yaw = atan2(rotation[1, 0], rotation[0, 0])
    roll = atan2(
        sin(yaw) * rotation[0, 2] - cos(yaw) * rotation[1, 2], cos(yaw) * rotation[1, 1] - sin(yaw) * rotation[0, 1]
    )
    return roll, atan2(-rotation[2, 0], hypot(rotation[0, 0], rotation[1, 0])), yaw


def _triple(vector: Floats) -> Triple:
    x, y, z = vector.tolist()
    return x, y, z
