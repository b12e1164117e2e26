"""Planning of the tool's pose."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import PcmrsError, RefusalError, UnreachableError
from pcmrs.kinematics.inverse import inverse
from pcmrs.spatial import Floats, Frame, Transform
from pcmrs.workflows._arguments import check_metres
from pcmrs.workflows._collision_checks import check_postures, update_collision_scene
from pcmrs.workflows._landmarks import check_same_head
from pcmrs.workflows._paths import along_axis
from pcmrs.workflows.accuracy import check_tre
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Planned, Point, as_message, as_transform
from pcmrs.workflows.reference import RECENT, check_reference
from pcmrs.workflows.zones import BODY

Run = AnyRun[Cell, PlacementData]
P = TypeVar("P", bound=PlacementData)

POSTURE_TOLERANCE = 0.05
"""Largest difference in any joint of postures that count as the same, rad."""
POSITION_KNOWN = ("standoff", "placed", "replanned")
"""States of the placement in which the tool rests where a plan has brought it."""
SEED_TURNS = (0.0, 0.8, -0.8, 1.6, -1.6)
"""Angles by which joints 1 and 3 are turned against each other for the seeds of a search, rad. This swings the
elbow."""


class ToolPose(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `plan`: ``image_from_tool_tip``, whose +z axis points away from the body.

    Attributes:
        position: Position in the image, m.
        quat_xyzw: Unit quaternion x y z w.
    """

    position: Point
    quat_xyzw: tuple[float, float, float, float]


def plan_reachable(run: Run) -> None:
    """Refuse an invalid pose and, once everything needed is known, a pose that the arm cannot reach."""
    accept_pose(run, pose_of(run.payload))


def pose_of(requested: ToolPose) -> Transform:
    """Return the requested ``image_from_tool_tip``.

    Raises:
        GeometryError: The pose is invalid.
        RefusalError: The pose is too far away to be in m.
    """
    pose = Transform.from_quat_xyzw(requested.position, requested.quat_xyzw)
    check_metres(pose.translation)
    return pose


def accept_pose(run: AnyRun[Cell, P], pose: Transform) -> None:
    """Prepare a pose as the plan.

    Args:
        run: Present operation.
        pose: Planned ``image_from_tool_tip``.

    Raises:
        RefusalError: The registration is not accurate enough, or every posture found is in a zone.
        UnreachableError: The arm cannot reach the pose.
    """
    missing = _missing_prerequisite(run)
    if missing:
        run.undecided.append(f"Whether the arm reaches it is not known before {missing}.")
    else:
        next(standoff_postures(run, pose))
    tre = check_tre(run.cell, run.data, pose.translation)
    run.result |= {} if tre is None else {"tre": tre}
    run.prepared = pose


def standoff_postures(
    run: AnyRun[Cell, P], image_from_tool_tip: Transform, start: Floats | None = None
) -> Iterator[Floats]:
    """Yield joint positions at the standoff of a planned pose, rad, (n,), that keep out of the zones.

    They keep out of the zones at the standoff and at the target.

    The posture nearest to the one at the start comes first, then those with the elbow to either side. All of them keep
    the forearm away from the body if that takes no long detour.

    Args:
        run: Present operation.
        image_from_tool_tip: Planned pose.
        start: Posture at the start of the way there, rad, (n,); None for the present one.

    Raises:
        UnreachableError: Standoff or target cannot be reached within the joint limits.
        RefusalError: Tool or body are not seen, or every posture found is in a zone.
    """
    cell, placement = run.cell, run.cell.settings.placement
    base_from_tool_tip = cell.frames(run.data).get(Frame.ROBOT_BASE, Frame.IMAGE) @ image_from_tool_tip
    update_collision_scene(cell, run.data)
    standoff = cell.flange_for(base_from_tool_tip @ along_axis(placement.standoff))
    target = cell.flange_for(base_from_tool_tip @ along_axis(placement.confirm_offset))
    body = _body_sphere(cell)
    found: list[Floats] = []
    refused: list[PcmrsError] = []
    for seed in _seeds(cell, cell.posture() if start is None else start):
        try:
            posture = inverse(cell.arm, standoff, seed, keep_away=body)
            # The posture at the target is solved from that at the standoff, where the straight path begins.
            check_postures(cell, posture, inverse(cell.arm, target, posture, keep_away=body))
        except (UnreachableError, RefusalError) as error:
            refused.append(error)
            continue
        if all(np.abs(posture - other).max() > POSTURE_TOLERANCE for other in found):
            found.append(posture)
            yield posture
    if not found:
        raise refused[0]


def _body_sphere(cell: Cell) -> Floats | None:
    """Return a sphere around the body: centre and radius in the robot's base, m, (4,); None without a surface."""
    model = cell.zones.model
    return model.bounding_sphere(BODY) if model.pairs_of_zone(BODY).any() else None


def _seeds(cell: Cell, start: Floats) -> Iterator[Floats]:
    swing = np.zeros(len(start))
    swing[[0, 2]] = 1.0, -1.0
    for turn in SEED_TURNS:
        yield np.clip(start + turn * swing, cell.arm.lower, cell.arm.upper)


def keep_plan(run: Run) -> None:
    """Put the plan in force."""
    cell = run.cell
    planned = Planned(
        id=f"plan-{run.command.id}",
        image_from_coil=as_message(run.prepared),
        patient=cell.settings.patient,
        calibration=cell.calibration_id,
        reference=run.data.reference,
        reference_serial=cell.settings.calibration.reference_serial,
    )
    run.keep(plan=planned.image_from_coil, plan_id=planned.id, previous_plan=planned)


def judge_position(run: Run) -> None:
    """Decide if the position of a tool at the body stays known under the plan that `keep_plan` has put in force.

    It does if the tool rests where an earlier plan has brought it, by the registration in force, and Stop is not
    latched. Everywhere else this has no effect: the outcome diverts a revocation, and nothing is revoked there.
    """
    data = run.data
    brought = data.approached is not None and data.approached[1] == data.registration_id
    known = brought and not run.latched and run.states["placement"] in POSITION_KNOWN
    run.outcome = "replanned" if known else "planned"


def previous_plan_fits(run: Run) -> None:
    """Refuse a previous plan of another patient, calibration or place of the reference.

    Also refuse one that `plan` would refuse.
    """
    previous = run.data.previous_plan
    if previous is None:
        raise RefusalError("no_previous_plan", "No tool pose was planned before: plan one.")
    check_same_head(run.cell, previous)
    check_reference(run.cell, previous.reference, run.clock.monotonic() - RECENT)
    accept_pose(run, as_transform(previous.image_from_coil))


def _missing_prerequisite(run: AnyRun[Cell, P]) -> str:
    """Return the condition that must hold before reach can be decided; empty if it can be decided."""
    poses = run.cell.poses
    if run.states.get("registration") != "111":
        return "a registration"
    if run.states.get("robot") != "1" or run.cell.joints is None:
        return "the robot is connected"
    return "" if poses.seen("coil") and poses.seen("body_ref") else "the tracker sees tool and body"


def register_plan_operations(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these checks and steps."""
    registry.payload("tool_pose", ToolPose)
    registry.long_check(plan_reachable)
    registry.long_check(previous_plan_fits)
    for step in (keep_plan, judge_position):
        registry.step(step)
