"""Motion of the tool and measurement of its pose."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, TypeVar

import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Frame, Transform, distance, mean_transform, rotation_angle
from pcmrs.workflows._connection import clear_state
from pcmrs.workflows._guard import follow_guarded
from pcmrs.workflows._paths import along_axis
from pcmrs.workflows._placement import (
    NO_NUDGE,
    Departure,
    accumulated_nudges,
    at_present_plan,
    kept_nudges,
    onward_possible,
    planned_pose,
    target_pose,
)
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_transform

Run = AnyRun[Cell, PlacementData]
P = TypeVar("P", bound=PlacementData)

FRAMES_TIME = 1.0
"""Longest wait for a frame of the arm at rest, s. Without one, the tool is not seen."""

ONWARD_TIME = 5.0
"""Limit to plan the way from the standoff of the last plan, s of the machine. It takes some 0.1 s."""

MEASURING_TIME = 10.0
"""Longest wait for all frames of a measurement, s."""


async def follow_prepared(run: Run) -> None:
    """Follow the trajectory that the check has planned, and let the arm come to rest."""
    await follow(run, run.prepared)


async def leave_last_plan(run: Run) -> None:
    """Bring a tool at the place of the last plan to the standoff of that plan, and plan the rest of the way again.

    The body may have moved meanwhile. From elsewhere this has no effect.

    Raises:
        RefusalError: The arm was held, or the rest of the way is refused now, or was not planned in time.
    """
    if isinstance(run.prepared, Departure):
        # A joint state of the moving arm may arrive after the answer, and outdates the frames before it.
        await follow(run, run.prepared.to_last_standoff)
        await _wait_for_frame_at_rest(run)
        await run.plan(onward_possible, within=ONWARD_TIME)


async def back_off_anew(run: Run) -> None:
    """Plan the way back again if the arm has followed the body or the teleoperator until now."""
    await _replan(run)


async def home_anew(run: Run) -> None:
    """Plan the way home again if the arm has followed the body or the teleoperator until now."""
    await _replan(run)


async def initial_anew(run: Run) -> None:
    """Plan the way to the initial posture again if the arm has followed the body or the teleoperator until now."""
    await _replan(run)


async def _replan(run: Run) -> None:
    """Plan again from the arm's present rest, because the check saw an arm that moved on afterwards."""
    if run.states["placement"] in ("following", "guided"):
        await _wait_for_frame_at_rest(run)
        await run.replan()


def remember_approach(run: Run) -> None:
    """Store the plan and the registration that the standoff belongs to, and reset the nudges."""
    data = run.data
    run.keep(approached=(data.plan_id, data.registration_id), approached_pose=data.plan)
    run.keep(nudge_translation=NO_NUDGE, nudge_rotation_zyx=NO_NUDGE)


def drop_nudges(run: Run) -> None:
    """Reset the nudges that a confirm has not kept."""
    kept = kept_nudges(run)
    run.keep(nudge_translation=kept.nudge_translation, nudge_rotation_zyx=kept.nudge_rotation_zyx)


def remember_nudge(run: Run) -> None:
    """Add the nudge to the sum of nudges."""
    translation, rotation = accumulated_nudges(run)
    run.keep(nudge_translation=translation, nudge_rotation_zyx=rotation)


async def measure_placement(run: Run) -> None:
    """Measure the pose of the tool and its errors against the plan by the tracker.

    The translation error is ‖R_mᵀ(t_m − t_p) − s·e_z‖ for measured pose m, planned pose p and offset s along the tool's
    z axis. The rotation error is the angle of R_pᵀR_m. Intended nudges are part of the plan here.
    """
    offset = run.cell.settings.placement.confirm_offset
    # The errors account for the offset, so that the expected pose is that of the contact.
    measured, plan = await measure_coil(run), target_pose(kept_nudges(run), offset) @ along_axis(-offset)
    extra = {"planned": pose_result(planned_pose(run.data)), "confirm_offset": offset}
    run.result |= {**extra, **placement_errors(measured, plan, offset)}


def placement_errors(measured: Transform, expected: Transform, offset: float = 0.0) -> dict[str, Any]:
    """Return a measured pose and its errors against the expected one, as a result.

    Args:
        measured: Measured ``image_from_tool_tip``.
        expected: Expected ``image_from_tool_tip``.
        offset: Expected distance from it along the tool's +z axis, m.
    """
    error = measured.rotation.T @ (measured.translation - expected.translation) - np.array([0.0, 0.0, offset])
    return {
        "measured": pose_result(measured),
        "translation_error": float(np.linalg.norm(error)),
        "rotation_error": rotation_angle(expected, measured),
    }


async def find_where_retreat_ended(run: Run) -> None:
    """Decide if the tool is at the standoff of the plan in force or clear of the body; otherwise it is held there."""
    await _wait_for_frame_at_rest(run)
    run.outcome = "standoff" if _at_standoff(run) else clear_state(run)


async def measure_coil(run: AnyRun[Cell, P]) -> Transform:
    """Return ``image_from_tool_tip`` as the mean of new tracker frames, with the arm at rest.

    Raises:
        RefusalError: See `measure_frames`.
    """
    return mean_transform(await measure_frames(run))


async def measure_frames(run: AnyRun[Cell, P]) -> list[Transform]:
    """Return ``image_from_tool_tip`` by each of the new tracker frames of a measurement, with the arm at rest.

    Raises:
        RefusalError: There is no registration, or tool and body are not seen.
    """
    cell, placement = run.cell, run.cell.settings.placement
    registered = run.data.registered
    if registered is None:
        raise RefusalError("not_registered", "There is no registration, so the tool cannot be measured in the image.")
    frames = await cell.poses.collect(["coil", "body_ref"], placement.frames, timeout=MEASURING_TIME)
    image_from_body_ref = as_transform(registered.body_ref_from_image).inverse()
    tips = [frame["body_ref"].inverse() @ cell.mounting.tool_tip(frame["coil"]) for frame in frames]
    return [image_from_body_ref @ body_ref_from_tool_tip for body_ref_from_tool_tip in tips]


async def follow(run: Run, trajectory: JointTrajectory) -> None:
    """Follow a trajectory under guard, and let the arm come to rest.

    Args:
        run: Present operation.
        trajectory: Planned path.

    Raises:
        RefusalError: The arm was held.
    """
    ended = await follow_guarded(run.cell, trajectory, towards_body=run.motion == "approach")
    if ended.outcome != "done":
        raise RefusalError("motion_stopped", f"The motion was stopped: {ended.reason or 'held'}.")
    await run.clock.sleep(run.cell.settings.placement.settle_time)


async def _wait_for_frame_at_rest(run: Run) -> None:
    """Wait for one frame of the arm at rest, which may be delayed or never come."""
    with suppress(RefusalError):
        await run.cell.poses.collect(["coil", "body_ref"], 1, timeout=FRAMES_TIME)


def _at_standoff(run: Run) -> bool:
    data, placement = run.data, run.cell.settings.placement
    in_force = run.states["registration"] == "111" and run.states["toolplan"] == "1"
    if not in_force or not at_present_plan(data):
        return False
    try:
        measured = run.cell.frames(data).get(Frame.IMAGE, Frame.TOOL_TIP)
    except RefusalError:
        return False
    return (
        distance(planned_pose(data) @ along_axis(placement.standoff), measured) * 1000
        <= placement.standoff_tolerance_mm
    )


def pose_result(pose: Transform) -> dict[str, list[float]]:
    """Return a pose in the form of results."""
    return {"position": pose.translation.tolist(), "quat_xyzw": pose.quat_xyzw.tolist()}


def register_motion_steps(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these steps."""
    for step in (remember_approach, remember_nudge, drop_nudges):
        registry.step(step)
    for replanning in (back_off_anew, home_anew, initial_anew):
        registry.world_step(replanning)
    for moving in (leave_last_plan, follow_prepared):
        registry.world_step(moving, moves=True)
    for world_step in (measure_placement, find_where_retreat_ended):
        registry.world_step(world_step)
