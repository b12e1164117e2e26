"""Planning the pose of the tool."""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.kinematics.inverse import inverse
from pcmrs.spatial import Frame, Transform
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Point, as_message
from pcmrs.workflows.paths import along_axis

Run = AnyRun[Cell, PlacementData]
P = TypeVar("P", bound=PlacementData)

FARTHEST_TARGET = 1.0
"""A target farther than this from the origin of the image (m) was probably given in mm."""


class ToolPose(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `plan`: ``image_from_coil``, m and unit quaternion; +z points away from the body."""

    position: Point
    quat_xyzw: tuple[float, float, float, float]


def plan_reachable(run: Run) -> None:
    """Refuses what is no pose, and once everything is known to decide it, what the arm cannot reach."""
    accept_pose(run, pose_of(run.payload))


def pose_of(asked: ToolPose) -> Transform:
    """``image_from_coil`` that was asked for.

    Raises:
        GeometryError: It is no pose.
        RefusalError: It is too far away to be in m.
    """
    pose = Transform.from_quat_xyzw(asked.position, asked.quat_xyzw)
    farthest = float(np.abs(pose.translation).max())
    if farthest > FARTHEST_TARGET:
        text = f"A coordinate is {farthest:g} m; the limit is {FARTHEST_TARGET:g} m. Were these millimetres?"
        raise RefusalError("wrong_unit", text, value=farthest, limit=FARTHEST_TARGET)
    return pose


def accept_pose(run: AnyRun[Cell, P], pose: Transform) -> None:
    """Prepares a pose as the plan; refuses it where it is known to be out of the arm's reach."""
    if run.states.get("registration") == "111" and run.states.get("robot") == "1" and _all_seen(run):
        check_reachable(run, pose)
    run.prepared = pose


def check_reachable(run: AnyRun[Cell, P], image_from_coil: Transform) -> Any:
    """Joints at the standoff of a planned pose, rad, (7,).

    Raises:
        UnreachableError: Standoff or target cannot be reached within the joint limits.
        RefusalError: Tool or body are not seen.
    """
    cell, placement = run.cell, run.cell.settings.placement
    base_from_image = cell.frames(run.data).get(Frame.ROBOT_BASE, Frame.IMAGE)
    standoff = cell.flange_for(base_from_image @ image_from_coil @ along_axis(placement.standoff))
    target = cell.flange_for(base_from_image @ image_from_coil @ along_axis(placement.confirm_offset))
    posture = inverse(cell.arm, standoff, cell.posture())
    inverse(cell.arm, target, posture)
    return posture


def keep_plan(run: Run) -> None:
    """Puts the plan in force."""
    run.keep(plan=as_message(run.prepared), plan_id=f"plan-{run.command.id}")


def _all_seen(run: AnyRun[Cell, P]) -> bool:
    poses = run.cell.poses
    return poses.seen("coil") and poses.seen("body_ref") and run.cell.joints is not None


def register_plan_operations(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for these checks and steps."""
    registry.payload("tool_pose", ToolPose)
    registry.check(plan_reachable)
    registry.step(keep_plan)
