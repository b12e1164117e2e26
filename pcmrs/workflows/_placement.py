"""Checks before the tool moves: each plans the whole motion or refuses it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import PcmrsError, RefusalError, UnreachableError
from pcmrs.kinematics.trajectory import concatenate
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Frame, Transform
from pcmrs.workflows._arguments import Retreat
from pcmrs.workflows._collision_checks import check_away, check_towards, plan_joint_path, plan_linear_path
from pcmrs.workflows._earlier_body import check_confirmed
from pcmrs.workflows._paths import (
    along_axis,
    check_ends_clear,
    check_only_grows,
    check_passes_clear,
    distance_until_clear,
)
from pcmrs.workflows.accuracy import check_tre
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Point, as_transform
from pcmrs.workflows.toolplan import standoff_postures

Run = AnyRun[Cell, PlacementData]

NO_NUDGE: Point = (0.0, 0.0, 0.0)

MAX_POSTURES = 3
"""Greatest number of postures at the standoff that are tried. Each takes about 50 ms to plan."""

LIMIT_RESERVE = 0.005
"""Distance by which a retreat stops before the place where the arm can no longer follow the line, m."""

BY_HAND = "Register the body again, or bring the arm away by hand, with the robot's own controls; then back off."
"""Advice if even backing off is refused."""


class Nudge(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `nudge`, in the tool frame.

    Attributes:
        translation: Translation, m.
        rotation_zyx: Rotations about z, y, x, rad.
    """

    translation: Point = NO_NUDGE
    rotation_zyx: Point = NO_NUDGE


@dataclass(frozen=True, slots=True)
class Departure:
    """Way from the place of the last plan to the standoff of the present one.

    Attributes:
        to_last_standoff: Straight path along the tool's axis to the standoff of the last plan.
        onward: Path from there, as planned in advance. It is planned again once the tool is there.
    """

    to_last_standoff: JointTrajectory
    onward: JointTrajectory

    @property
    def stops(self) -> list[int]:
        """Stops of the whole way; see `JointTrajectory`."""
        before = len(self.to_last_standoff.positions) - 1
        return [*self.to_last_standoff.stops, *(before + stop for stop in self.onward.stops)]

    @property
    def duration(self) -> float:
        """Longest duration of both motions, s."""
        return self.to_last_standoff.duration + self.onward.duration


def approach_possible(run: Run) -> None:
    """Plan the path to the standoff, with another posture if the first one is refused.

    A tool that is still at the place of the last plan goes to the standoff of that plan first; `Departure` is prepared
    then. The approach is refused if the registration is not accurate enough at the target, each path passes a zone or
    the body, or the target is out of reach.
    """
    if run.states["placement"] != "replanned":
        run.prepared = _plan_to_standoff(run, run.cell.posture())
        return
    away = _plan_to_last_standoff(run)
    run.prepared = Departure(away, _plan_to_standoff(run, np.asarray(away.positions[-1])))


def onward_possible(run: Run) -> None:
    """Plan the path to the standoff from where the tool is now: at the standoff of the last plan."""
    run.prepared = _plan_to_standoff(run, run.cell.posture())


def confirm_possible(run: Run) -> None:
    """Plan the straight path to the target: along the tool's axis, or after a motion of the head where it is now."""
    check_at_present_plan(run.data)
    kept = kept_nudges(run)
    target = target_pose(kept, run.cell.settings.placement.confirm_offset)
    if run.states["placement"] == "placed":
        _check_realignment(run, target)
    run.prepared = _plan_straight_to(run, target)


def nudge_possible(run: Run) -> None:
    """Plan the straight path to the nudged pose, and refuse a sum of nudges that is too large."""
    check_at_present_plan(run.data)
    limits = run.cell.settings.placement
    translation, rotation = accumulated_nudges(run)
    check_nudges(run, translation, rotation)
    height = limits.standoff if run.states["placement"] == "standoff" else limits.confirm_offset
    nudged = msgspec.structs.replace(run.data, nudge_translation=translation, nudge_rotation_zyx=rotation)
    run.prepared = _plan_straight_to(run, target_pose(nudged, height))


def check_nudges(run: Run, translation: Point, rotation_zyx: Point) -> None:
    """Refuse a sum of nudges that is too large.

    Args:
        run: Present operation.
        translation: Sum of translations, m.
        rotation_zyx: Sum of rotations about z, y, x, rad.

    Raises:
        RefusalError: ``nudge_too_large``.
    """
    limits = run.cell.settings.placement
    length, angle = math.dist(NO_NUDGE, translation), nudge_transform(NO_NUDGE, rotation_zyx).rotvec
    turned = math.degrees(float(np.linalg.norm(angle)))
    if length * 1000.0 > limits.nudge_limit_mm or turned > limits.nudge_limit_deg:
        text = (
            f"The nudges would add up to {length * 1000:.1f} mm and {turned:.1f}°; the limits are "
            f"{limits.nudge_limit_mm:g} mm and {limits.nudge_limit_deg:g}°. Plan another pose instead."
        )
        raise RefusalError("nudge_too_large", text, translation=length, rotation_deg=turned)


def retreat_possible(run: Run) -> None:
    """Plan the straight path back along the tool's axis: to its standoff, or until it is clear of the body.

    If the arm cannot follow that line to its end, the path continues home. Backing off is the only way out of `held`,
    so a joint limit on the line must not refuse it. Neither must a body of which only the reference has been seen: the
    reference may be beside the body, while +z leads away from the body by definition. Only the path home is checked
    against the reference.
    """
    cell = run.cell
    straight, complete = _plan_back_off(run)
    middle_known = cell.base_from_body_ref is not None and cell.middle_in_body_ref is not None
    run.prepared = straight if complete else _append_way_home(run, straight, checked_later=middle_known)
    if middle_known:
        check_only_grows(cell, run.prepared, run.data, BY_HAND)
    check_away(cell, run.data, run.prepared)


def home_grows_distance(run: Run) -> None:
    """Plan the path to the home posture, which may only lead away from the body."""
    run.prepared = _plan_retreat(run, list(run.cell.home))


def initial_grows_distance(run: Run) -> None:
    """Plan the path to the initial posture, which may only lead away from the body."""
    run.prepared = _plan_retreat(run, run.cell.initial_joints or list(run.cell.home))


def planned_pose(data: PlacementData) -> Transform:
    """Return ``image_from_tool_tip`` of the plan in force. Raises `RefusalError` if there is none."""
    if data.plan is None:
        raise RefusalError("no_plan", "No tool pose is planned: plan one first.")
    return as_transform(data.plan)


def target_pose(data: PlacementData, height: float) -> Transform:
    """Return ``image_from_tool_tip`` of the plan with all nudges, shifted along the tool's axis.

    Args:
        data: Data of the procedure.
        height: Shift along the tool's +z axis, away from the body, m.

    Raises:
        RefusalError: There is no plan.
    """
    return planned_pose(data) @ along_axis(height) @ nudge_transform(data.nudge_translation, data.nudge_rotation_zyx)


@lru_cache(maxsize=64)
def nudge_transform(translation: Point, rotation_zyx: Point) -> Transform:
    """Return ``tool_tip_from_nudged`` of a nudge.

    Args:
        translation: Translation, m.
        rotation_zyx: Rotations about z, y, x, rad.
    """
    return Transform.from_zyx(translation, rotation_zyx)


def accumulated_nudges(run: Run) -> tuple[Point, Point]:
    """Return the sums of nudges, including the requested one: translation in m and rotations in rad."""
    data, request = run.data, run.payload
    x, y, z = np.add(data.nudge_translation, request.translation).tolist()
    rz, ry, rx = np.add(data.nudge_rotation_zyx, request.rotation_zyx).tolist()
    return (x, y, z), (rz, ry, rx)


def kept_nudges(run: Run) -> PlacementData:
    """Return the data with the nudges that a confirm keeps: all of them, or none if the settings say so."""
    if not run.cell.settings.placement.confirm_drops_nudges:
        return run.data
    return msgspec.structs.replace(run.data, nudge_translation=NO_NUDGE, nudge_rotation_zyx=NO_NUDGE)


def _check_realignment(run: Run, image_from_target: Transform) -> None:
    """Refuse to go straight to a target that is farther from the placed tool than nudges may lead.

    Raises:
        RefusalError: ``realignment_too_large``.
    """
    limits = run.cell.settings.placement
    measured_from_target = run.cell.image_from_tool_tip(run.data).inverse() @ image_from_target
    shift_mm = float(np.linalg.norm(measured_from_target.translation)) * 1000.0
    turn_deg = math.degrees(float(np.linalg.norm(measured_from_target.rotvec)))
    if shift_mm > limits.nudge_limit_mm or turn_deg > limits.nudge_limit_deg:
        text = (
            f"The target is {shift_mm:.1f} mm and {turn_deg:.1f}° from the placed tool; the limits are "
            f"{limits.nudge_limit_mm:g} mm and {limits.nudge_limit_deg:g}°. Back off, then approach again."
        )
        raise RefusalError("realignment_too_large", text, shift_mm=shift_mm, turn_deg=turn_deg)


def _plan_to_last_standoff(run: Run) -> JointTrajectory:
    """Plan the straight path along the tool's +z axis to the height of the standoff of the plan that it came by."""
    cell, data = run.cell, run.data
    if data.approached is None or data.approached_pose is None or data.approached[1] != data.registration_id:
        text = "It is not known by which plan and registration the tool was brought here: back off, then approach."
        raise RefusalError("not_at_plan", text, registration=data.registration_id)
    height = float((as_transform(data.approached_pose).inverse() @ cell.image_from_tool_tip(data)).translation[2])
    path = _plan_straight_away(run, max(0.0, cell.settings.placement.standoff - height))
    check_only_grows(cell, path, data, BY_HAND)
    check_away(cell, data, path)
    return path


def _plan_to_standoff(run: Run, start: Floats) -> JointTrajectory:
    """Plan the path from a posture to the standoff of the plan in force. Raises the first refusal if none is found."""
    check_tre(run.cell, run.data, planned_pose(run.data).translation)
    refused: list[PcmrsError] = []
    for posture in islice(standoff_postures(run, planned_pose(run.data), start), MAX_POSTURES):
        try:
            return _plan_approach(run, start, posture)
        except (RefusalError, UnreachableError) as error:
            refused.append(error)
    raise refused[0]


def _plan_approach(run: Run, start: Floats, posture: Floats) -> JointTrajectory:
    """Plan the path to a posture at the standoff from which the target can be reached."""
    cell = run.cell
    base_from_image = cell.frames(run.data).get(Frame.ROBOT_BASE, Frame.IMAGE)
    path = plan_joint_path(run, start, posture)
    check_passes_clear(cell, path, run.data)
    base_from_target = base_from_image @ planned_pose(run.data)
    check_towards(cell, run.data, path, base_from_target)
    _plan_line(run, posture, base_from_target @ along_axis(cell.settings.placement.confirm_offset), base_from_target)
    return path


def _plan_straight_to(run: Run, image_from_tool_tip: Transform) -> JointTrajectory:
    """Plan the straight path of the coil from its present pose to a pose in the image."""
    base_from_image = run.cell.frames(run.data).get(Frame.ROBOT_BASE, Frame.IMAGE)
    base_from_target = base_from_image @ planned_pose(run.data)
    return _plan_line(run, run.cell.posture(), base_from_image @ image_from_tool_tip, base_from_target)


def _plan_line(run: Run, start: Floats, base_from_tool_tip: Transform, base_from_target: Transform) -> JointTrajectory:
    """Plan the straight path of the coil from joint positions to a pose near the target of the plan."""
    path = plan_linear_path(run, start, base_from_tool_tip, near=True)
    check_towards(run.cell, run.data, path, base_from_target)
    return path


def _plan_retreat(run: Run, posture: list[float]) -> JointTrajectory:
    """Plan a retreat along the axis if the tool is at the body, and then a motion of the joints to a posture."""
    cell = run.cell
    path = None if run.states["placement"] == "retracted" else _plan_back_off(run)[0]
    start = cell.posture() if path is None else path.positions[-1]
    trajectory = plan_joint_path(run, start, posture)
    trajectory = trajectory if path is None else concatenate(path, trajectory)
    check_confirmed(run, trajectory)
    check_only_grows(cell, trajectory, run.data)
    check_ends_clear(cell, trajectory, run.data)
    check_away(cell, run.data, trajectory)
    return trajectory


def _plan_back_off(run: Run) -> tuple[JointTrajectory, bool]:
    """Plan a straight path along the tool's +z axis to the standoff, and return it with a flag.

    The flag is False if the path was shortened because the arm cannot follow it any farther.
    """
    length = whole = _retreat_length(run)
    while True:
        try:
            return _plan_straight_away(run, length), length == whole
        except UnreachableError as error:
            shorter = error.fields.get("parameter", 0.0) * length - LIMIT_RESERVE
            length = shorter if shorter > LIMIT_RESERVE else 0.0  # not worth moving for


def _append_way_home(run: Run, straight: JointTrajectory, *, checked_later: bool) -> JointTrajectory:
    """Append the path home to a shortened straight path; return the straight path alone if the path home is refused."""
    cell = run.cell
    home = plan_joint_path(run, straight.positions[-1], cell.home)
    if not checked_later:
        try:
            check_confirmed(run, home)
            check_only_grows(cell, home, run.data, BY_HAND)
        except RefusalError:
            if len(straight.positions) == 1:
                raise
            return straight
    return concatenate(straight, home)


def _plan_straight_away(run: Run, length: float) -> JointTrajectory:
    """Plan a straight path along the tool's +z axis. Raises `UnreachableError` if the arm cannot follow it."""
    cell = run.cell
    base_from_tool_tip = cell.arm.forward(cell.posture()) @ cell.flange_from_tool_tip
    fine = cell.settings.placement.standoff
    return plan_linear_path(run, cell.posture(), base_from_tool_tip @ along_axis(length), fine=fine)


def _retreat_length(run: Run) -> float:
    """Return the distance to the tool's standoff if it is on its axis; otherwise the distance until it is clear, m."""
    try:
        distance = _distance_to_standoff(run)
        return distance_until_clear(run.cell, run.data) if distance is None else distance
    except RefusalError:  # neither tool nor body is seen, nor has been
        return run.cell.settings.placement.standoff


def _distance_to_standoff(run: Run) -> float | None:
    placement, data = run.cell.settings.placement, run.data
    if data.plan is None or data.registered is None or not at_present_plan(data):
        return None
    x, y, height = (planned_pose(data).inverse() @ run.cell.image_from_tool_tip(data)).translation
    tolerance = placement.standoff_tolerance_mm / 1000.0
    if math.hypot(x, y) > tolerance or height > placement.standoff + tolerance:
        return None
    return max(0.0, float(placement.standoff - height))


def at_present_plan(data: PlacementData) -> bool:
    """Return True if the tool was brought to the plan and registration that are in force."""
    return data.approached is not None and data.approached == (data.plan_id, data.registration_id)


def check_at_present_plan(data: PlacementData) -> None:
    """Refuse to go on if the tool was not brought there for this plan, whatever the states say.

    Raises:
        RefusalError: ``not_at_plan``.
    """
    if not at_present_plan(data):
        text = "The tool was not brought to the plan and registration in force: back off, then approach again."
        raise RefusalError("not_at_plan", text, plan=data.plan_id, registration=data.registration_id)


def register_placement_checks(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these checks."""
    registry.payload("nudge", Nudge)
    registry.payload("retreat", Retreat)
    for check in (approach_possible, onward_possible, confirm_possible, nudge_possible, retreat_possible):
        registry.long_check(check)
    for check in (home_grows_distance, initial_grows_distance):
        registry.long_check(check)
