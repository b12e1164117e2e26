"""Moving the tool, and measuring where it is."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, TypeVar

import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Frame, Transform, distance, mean_transform, rotation_angle
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.connection import where_clear
from pcmrs.workflows.data import PlacementData, as_transform
from pcmrs.workflows.guard import follow_guarded
from pcmrs.workflows.paths import along_axis
from pcmrs.workflows.placement import (
    NOTHING,
    at_present_plan,
    nudges_with,
    planned,
    target,
)

Run = AnyRun[Cell, PlacementData]
P = TypeVar("P", bound=PlacementData)

FRAMES_TIME = 1.0
"""A frame of an arm at rest comes within this, s, or nobody sees where it is."""

MEASURING_TIME = 10.0
"""All frames of a measurement come within this, s."""


async def follow_prepared(run: Run) -> None:
    """Follows the trajectory that the check has planned, and lets the arm come to rest."""
    await follow(run, run.prepared)


async def back_off_anew(run: Run) -> None:
    """Plans the way back again where the arm followed body or teleoperator until now."""
    await _replan(run)


async def home_anew(run: Run) -> None:
    """Plans the way home again where the arm followed body or teleoperator until now."""
    await _replan(run)


async def initial_anew(run: Run) -> None:
    """Plans the way to the initial posture again where the arm followed body or teleoperator until now."""
    await _replan(run)


async def _replan(run: Run) -> None:
    """The check has seen an arm that moved on after it: now it stands."""
    if run.states["placement"] in ("following", "guided"):
        await _seen_at_rest(run)
        await run.replan()


def remember_approach(run: Run) -> None:
    """The standoff belongs to this plan and this registration; nudges start anew."""
    approached = (run.data.plan_id, run.data.registration_id)
    run.keep(approached=approached, nudge_translation=NOTHING, nudge_rotation_zyx=NOTHING)


def remember_nudge(run: Run) -> None:
    """Nudges add up."""
    translation, rotation = nudges_with(run)
    run.keep(nudge_translation=translation, nudge_rotation_zyx=rotation)


async def measure_placement(run: Run) -> None:
    """Measures the pose of the tool and its errors against the plan, both by the tracker.

    Translation error ‖R_mᵀ(t_m − t_p) − s·e_z‖ for measured m, planned p and offset s along the tool's z axis;
    rotation error is the angle of R_pᵀR_m. What the operator has nudged on purpose is part of the plan here.
    """
    offset = run.cell.settings.placement.confirm_offset
    measured, plan = await measure_coil(run), target(run.data, offset) @ along_axis(-offset)
    told = {"planned": as_result(planned(run.data)), "confirm_offset": offset}
    run.result |= {**told, **errors_of(measured, plan, offset)}


def errors_of(measured: Transform, expected: Transform, offset: float = 0.0) -> dict[str, Any]:
    """A measured pose and its errors against the one expected, `offset` (m) away along the tool's axis, as a result."""
    error = measured.rotation.T @ (measured.translation - expected.translation) - np.array([0.0, 0.0, offset])
    return {
        "measured": as_result(measured),
        "translation_error": float(np.linalg.norm(error)),
        "rotation_error": rotation_angle(expected, measured),
    }


async def find_where_retreat_ended(run: Run) -> None:
    """At the standoff of the plan in force, clear of the body, or neither: then it is held where it is."""
    await _seen_at_rest(run)
    run.outcome = "standoff" if _at_standoff(run) else where_clear(run)


async def measure_coil(run: AnyRun[Cell, P]) -> Transform:
    """``image_from_coil`` as the mean of fresh tracker frames, with the arm at rest."""
    cell, placement = run.cell, run.cell.settings.placement
    registered = run.data.registered
    if registered is None:
        raise RefusalError("not_registered", "There is no registration to measure the tool in the image by.")
    frames = await cell.poses.collect(["coil", "body_ref"], placement.frames, timeout=MEASURING_TIME)
    image_from_body_ref = as_transform(registered.body_ref_from_image).inverse()
    return mean_transform([image_from_body_ref @ frame["body_ref"].inverse() @ frame["coil"] for frame in frames])


async def follow(run: Run, trajectory: JointTrajectory) -> None:
    """Follows a trajectory past the zones, and lets the arm come to rest. Raises `RefusalError` where it was held."""
    ended = await follow_guarded(run.cell, trajectory, towards_body=run.motion == "approach")
    if ended.outcome != "done":
        raise RefusalError("motion_stopped", f"The motion was stopped: {ended.reason or 'held'}.")
    await run.clock.sleep(run.cell.settings.placement.settle_time)


async def _seen_at_rest(run: Run) -> None:
    """The tracker's frames of the arm at rest may still be on their way, or never come."""
    with suppress(RefusalError):
        await run.cell.poses.collect(["coil", "body_ref"], 1, timeout=FRAMES_TIME)


def _at_standoff(run: Run) -> bool:
    data, placement = run.data, run.cell.settings.placement
    in_force = run.states["registration"] == "111" and run.states["toolplan"] == "1"
    if not in_force or not at_present_plan(data):
        return False
    try:
        measured = run.cell.frames(data).get(Frame.IMAGE, Frame.COIL)
    except RefusalError:
        return False
    return distance(planned(data) @ along_axis(placement.standoff), measured) * 1000 <= placement.standoff_tolerance_mm


def as_result(pose: Transform) -> dict[str, list[float]]:
    """A pose as results have it."""
    return {"position": pose.translation.tolist(), "quat_xyzw": pose.quat_xyzw.tolist()}


def register_motion_steps(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for these steps."""
    for step in (remember_approach, remember_nudge):
        registry.step(step)
    for replanning in (back_off_anew, home_anew, initial_anew):
        registry.world_step(replanning)
    registry.world_step(follow_prepared, moves=True)
    for world_step in (measure_placement, find_where_retreat_ended):
        registry.world_step(world_step)
