"""Planning of paths that avoid the zones and are slower near the body, and clearance limits of a motion in progress."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from dataclasses import replace
from typing import Self, TypeVar

import numpy as np
import numpy.typing as npt

from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.kinematics.sampled_clearance import ClearanceViolation
from pcmrs.kinematics.segments import in_segments
from pcmrs.kinematics.time_parameterization import SpeedLimitAt
from pcmrs.kinematics.trajectory import joint_motion, straight_motion
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows._earlier_body import earlier_registration
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_transform

P = TypeVar("P", bound=PlacementData)

OTHER_PATH_ADVICE = "Go home first, or plan another pose."
MANUAL_ADVICE = "Bring the arm away by hand, with the robot's own controls."

SAMPLES_PER_PART = 32
"""Number of samples of a motion whose clearance is computed without a pause: it takes about a millisecond."""


class ClearanceLimits:
    """Least distances of a motion in progress.

    They are the allowed distances, or the planned ones if these are smaller, less the permitted drift.

    Args:
        cell: Cell with placed zones.
        planned: Least distance of every pair along the planned motion, m, (P,).
    """

    def __init__(self, cell: Cell, planned: Floats) -> None:
        zones = cell.zones
        self._model = zones.model
        # A tool whose plan comes near the body may touch it. In all other motions it keeps its distance.
        limits = np.where(planned < zones.limits_afar, zones.limits, zones.limits_afar)
        self._limits = np.minimum(limits, planned) - cell.settings.zones.drift_limit

    @classmethod
    def at_posture(cls, cell: Cell, posture: npt.ArrayLike) -> Self:
        """Return the limits of an arm that rests at a posture.

        Args:
            cell: Cell with placed zones.
            posture: Joint positions, rad, (n,).
        """
        return cls(cell, cell.zones.model.distances(posture))

    @classmethod
    async def along_motion(cls, cell: Cell, positions: npt.ArrayLike) -> Self:
        """Return the limits of a planned motion.

        A long motion takes tens of milliseconds. The computation pauses after each part, because Stop may wait for the
        event loop no longer than a few milliseconds.

        Args:
            cell: Cell with placed zones.
            positions: Joint positions along the motion, rad, (N, n).
        """
        samples, planned = np.asarray(positions), []
        for start in range(0, len(samples), SAMPLES_PER_PART):  # each part ends where the next one begins
            part = samples[start : start + SAMPLES_PER_PART + 1]
            planned.append(cell.zones.sample_clearance(part).distances.min(axis=0))
            await asyncio.sleep(0)
        return cls(cell, np.min(planned, axis=0))

    def violation(self, positions: npt.ArrayLike) -> RefusalError | None:
        """Return the refusal for an arm at joint positions rad, (n,), that must be held; None if it may go on."""
        distances = self._model.distances(positions)
        pair = int(np.argmin(distances - self._limits))
        floor = float(self._limits[pair])
        if distances[pair] >= floor:
            return None
        found = self._model.clearance(distances, pair)
        text = (
            f"{found.link} came within {found.distance * 1000:.0f} mm of {found.zone}, nearer than {floor * 1000:.0f} "
            "mm, and the arm was held. Check the cell, then back off."
        )
        fields = {"link": found.link, "zone": found.zone, "distance": found.distance, "limit": floor}
        return RefusalError("zone_entered", text, **fields)


def check_towards(cell: Cell, data: PlacementData, trajectory: JointTrajectory, base_from_target: Transform) -> None:
    """Refuse a path to the body that passes a zone or leaves the approach cone.

    Args:
        cell: Cell whose zones are placed here.
        data: Data of the procedure.
        trajectory: Planned path.
        base_from_target: Planned pose of the tool in the robot's base.

    Raises:
        RefusalError: The path passes a zone, comes near the body away from the target, or comes to the target outside
            the cone or too deep.
    """
    update_collision_scene(cell, data)
    sampled = cell.zones.sample_clearance(trajectory.positions)
    points = np.array([cell.arm.forward(q) @ cell.flange_from_tool_tip.translation for q in sampled.postures])
    limits = cell.zones.limits_towards(base_from_target, points)
    _refuse(sampled.first_violation(cell.zones.model, limits), OTHER_PATH_ADVICE)
    _check_inside_cone(cell, sampled.postures, points, base_from_target)


def check_away(cell: Cell, data: PlacementData, trajectory: JointTrajectory) -> None:
    """Refuse a retreat into a zone. If it starts too near to a zone, it may only lead out of it.

    Args:
        cell: Cell whose zones are placed here.
        data: Data of the procedure.
        trajectory: Planned path.

    Raises:
        RefusalError: The path leads into a zone.
    """
    update_collision_scene(cell, data)
    sampled = cell.zones.sample_clearance(trajectory.positions)
    _refuse(sampled.first_approach(cell.zones.model, cell.zones.retreat_limits), MANUAL_ADVICE)


def check_postures(cell: Cell, *postures: Floats) -> None:
    """Refuse postures in a zone. The zones are those that `update_collision_scene` has placed last.

    Args:
        cell: Cell with placed zones.
        *postures: Joint positions, rad, (n,) each.

    Raises:
        RefusalError: A posture is in a zone.
    """
    zones = cell.zones
    for posture in postures:
        _refuse(zones.sample_clearance([posture]).first_violation(zones.model, zones.limits), OTHER_PATH_ADVICE)


def update_collision_scene(cell: Cell, data: PlacementData) -> None:
    """Place the body and the lines of sight at their present or last seen poses.

    Args:
        cell: Cell with zones and tracked poses.
        data: Data of the procedure.
    """
    # If tool or body are not seen now, their last poses stay.
    with suppress(RefusalError):
        cell.frames(data)
    if data.registered is not None:
        cell.remember_registered(data.registered)
    if cell.base_from_tracker is not None and cell.base_from_body_ref is not None:
        cell.zones.model.set_sight_lines(cell.base_from_tracker.translation, cell.base_from_body_ref.translation)
    earlier = earlier_registration(cell, data)
    cell.earlier_body_ref_from_image = None if earlier is None else as_transform(earlier.body_ref_from_image)
    body_ref_from_image = cell.body_ref_from_image or cell.earlier_body_ref_from_image
    if cell.base_from_body_ref is not None and body_ref_from_image is not None:
        cell.zones.place_body(cell.base_from_body_ref @ body_ref_from_image)


def place_body(cell: Cell, base_from_tracker: Transform, base_from_body_ref: Transform) -> None:
    """Place a moving body and the lines of sight to it.

    Args:
        cell: Cell with zones.
        base_from_tracker: Pose of the tracker in the robot's base.
        base_from_body_ref: Pose of the body's reference in the robot's base.
    """
    cell.base_from_body_ref = base_from_body_ref
    cell.zones.model.set_sight_lines(base_from_tracker.translation, base_from_body_ref.translation)
    if cell.body_ref_from_image is not None:
        cell.zones.place_body(base_from_body_ref @ cell.body_ref_from_image)


def plan_joint_path(run: AnyRun[Cell, P], start: npt.ArrayLike, goal: npt.ArrayLike) -> JointTrajectory:
    """Plan a motion of all joints together from rest to rest, slower near the body.

    Args:
        run: Present operation.
        start: Joint positions at the start, rad, (n,).
        goal: Joint positions at the end, rad, (n,).

    Raises:
        UnreachableError: `goal` breaks a joint limit.
    """
    cell = run.cell
    update_collision_scene(cell, run.data)
    limits, coil, speed_limit_at = cell.motion_limits(), cell.flange_from_tool_tip, _speed_limits(cell)
    path = joint_motion(cell.arm, start, goal, limits, flange_from_tool=coil, speed_limit_at=speed_limit_at)
    return _as_arm_moves(cell, path, 0.0)


def plan_linear_path(
    run: AnyRun[Cell, P], start: npt.ArrayLike, base_from_tool_tip: Transform, *, near: bool = False, fine: float = 0.0
) -> JointTrajectory:
    """Plan a straight motion of the tool from rest to rest, slower near the body.

    Args:
        run: Present operation.
        start: Joint positions at the start, rad, (n,).
        base_from_tool_tip: Pose of the tool at the end, in the robot's base.
        near: True if the whole motion must be slow, and its segments short if the arm moves in segments.
        fine: Length of the first part of the line whose segments must be short, m.

    Raises:
        UnreachableError: The arm cannot follow the line to its end.
    """
    cell = run.cell
    update_collision_scene(cell, run.data)
    limits, motion = cell.motion_limits(), cell.settings.motion
    if near:
        limits = replace(limits, linear_velocity=min(limits.linear_velocity, motion.near_velocity))
    goal, coil = cell.flange_for(base_from_tool_tip), cell.flange_from_tool_tip
    path = straight_motion(cell.arm, start, goal, limits, flange_from_tool=coil, speed_limit_at=_speed_limits(cell))
    return _as_arm_moves(cell, path, math.inf if near else fine)


def _as_arm_moves(cell: Cell, path: JointTrajectory, fine: float) -> JointTrajectory:
    """Return the motion along a path that the arm really makes: in segments, if it cannot do otherwise."""
    if not cell.point_to_point:
        return path
    slowest = min(cell.settings.motion.linear_velocity, cell.settings.motion.near_velocity)
    return in_segments(cell.arm, path, cell.motion_limits(), slowest, cell.flange_from_tool_tip, fine)


def _speed_limits(cell: Cell) -> SpeedLimitAt:
    motion = cell.settings.motion

    def speed_limit_at(postures: Floats) -> Floats:
        near = cell.zones.near_body(postures, motion.near_distance)
        return np.where(near, motion.near_velocity, motion.linear_velocity)

    return speed_limit_at


def _refuse(violation: ClearanceViolation | None, advice: str) -> None:
    if violation is None:
        return
    found = violation.clearance
    joints_deg = np.degrees(violation.posture).round(1).tolist()
    text = (
        f"{found.link} would be {found.distance * 1000:.0f} mm from {found.zone}, the limit is "
        f"{found.limit * 1000:.0f} mm, with the joints at {joints_deg}°. {advice}"
    )
    fields = {"link": found.link, "zone": found.zone, "distance": found.distance, "limit": found.limit}
    raise RefusalError("zone_violated", text, **fields, joints_deg=joints_deg)


def _check_inside_cone(cell: Cell, postures: Floats, points: Floats, base_from_target: Transform) -> None:
    excess = cell.zones.cone.excess(base_from_target, points)
    worst = int(np.argmax(excess))
    if excess[worst] > 0.0:
        x, y, z = (base_from_target.inverse() @ points[worst]).tolist()
        zones, joints_deg = cell.settings.zones, np.degrees(postures[worst]).round(1).tolist()
        text = (
            f"The tool point would be {np.hypot(x, y) * 1000:.0f} mm beside the planned axis, {z * 1000:.0f} mm above "
            f"the target, {excess[worst] * 1000:.0f} mm outside the cone of {zones.cone_half_angle_deg:g}° in which "
            f"the tool comes to the body, with the joints at {joints_deg}°. {OTHER_PATH_ADVICE}"
        )
        raise RefusalError("outside_cone", text, excess=float(excess[worst]), height=z, joints_deg=joints_deg)
