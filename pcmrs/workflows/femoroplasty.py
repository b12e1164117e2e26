"""Femoroplasty's own checks and steps: drill trajectory, the surgeon's confirmations, guide and hole."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.fsm import Effect
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows._arguments import PersonName, check_metres
from pcmrs.workflows._motion import measure_coil, placement_errors, pose_result
from pcmrs.workflows._placement import planned_pose
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Point, as_message, as_transform
from pcmrs.workflows.data import settle as settle_placement
from pcmrs.workflows.toolplan import accept_pose

MIN_LENGTH = 0.005
"""Least distance of entry and target, m. Nearer points give no reliable direction."""
MAX_LENGTH = 0.200
"""Greatest distance of entry and target, m: longer than any femoral neck."""
ANTERIOR, SUPERIOR = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
NEARLY_PARALLEL = 0.99

HOLE_STATES = ("drilling", "drilling_interrupted", "drilled", "checked", "injecting", "injecting_interrupted")
"""States of the treatment in which there is or will be a hole that is still needed."""


class Data(PlacementData, frozen=True, kw_only=True):
    """Data of a femoroplasty.

    Attributes:
        hole: ``image_from_tool_tip`` measured when the drill entered; None before that.
    """

    hole: PoseMessage | None = None


Run = AnyRun[Cell, Data]


class Trajectory(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `plan_trajectory`.

    Attributes:
        entry: Point at which the drill enters the bone, in the image, m.
        target: Point at which the drill ends, in the image, m.
    """

    entry: Point
    target: Point


class Confirmation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of operations that only the surgeon can confirm.

    Attributes:
        surgeon: Name of the confirming surgeon.
    """

    surgeon: PersonName


def guide_pose(entry: Floats, target: Floats) -> Transform:
    """Return ``image_from_tool_tip`` of a guide at the entry of a trajectory.

    The origin is the entry. +z points from the target to the entry, away from the body. +y is as superior as possible
    (anterior if the trajectory itself is superior), because a guide is symmetric about its axis.

    Args:
        entry: Entry in the image, m, (3,).
        target: Target in the image, m, (3,).
    """
    z = (entry - target) / np.linalg.norm(entry - target)
    # A superior trajectory leaves the direction of +y undefined.
    up = SUPERIOR if abs(z @ SUPERIOR) < NEARLY_PARALLEL else ANTERIOR
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return Transform(np.column_stack((x, np.cross(z, x), z)), entry)


def trajectory_reachable(run: Run) -> None:
    """Refuse points that are not a trajectory in a femur or, once this can be decided, that the arm cannot reach."""
    entry, target = np.array(run.payload.entry), np.array(run.payload.target)
    check_metres((entry, target))
    run.result["length"] = length = float(np.linalg.norm(entry - target))
    if not MIN_LENGTH <= length <= MAX_LENGTH:
        text = (
            f"Entry and target are {length * 1000:.1f} mm apart; a trajectory has {MIN_LENGTH * 1000:g} to "
            f"{MAX_LENGTH * 1000:g} mm. Pick both points in the same bone."
        )
        limits = [MIN_LENGTH, MAX_LENGTH]
        raise RefusalError("bad_trajectory", text, length=length, limits=limits)
    accept_pose(run, guide_pose(entry, target))


def record_confirmation(run: Run) -> None:
    """Put on record who confirmed which operation."""
    run.result |= {"surgeon": run.payload.surgeon, "confirmed": run.command.operation}


async def check_guide_on_plan(run: Run) -> None:
    """Measure the guide by the tracker, and refuse it if it is off the plan. Intended nudges count as errors, too.

    Raises:
        RefusalError: An error is over its limit, or the guide is not seen.
    """
    plan, offset = planned_pose(run.data), run.cell.settings.placement.confirm_offset
    run.prepared = measured = await measure_coil(run)
    run.result |= {"planned": pose_result(plan), **placement_errors(measured, plan, offset)}
    advice = "Back off and place it again, or plan another trajectory."
    _refuse_if_off(run, "guide", "the plan, nudges included", advice)


def keep_hole(run: Run) -> None:
    """Store the measured pose of the guide as that of the hole. Nudges and plans do not move it."""
    run.keep(hole=as_message(run.prepared))


async def check_guide_pose(run: Run) -> None:
    """Measure the guide by the tracker, and refuse it if it is not where it was when the hole was drilled.

    Raises:
        RefusalError: An error is over its limit, the guide is not seen, or the place of the hole is unknown.
    """
    if run.data.hole is None:
        raise RefusalError("no_hole", "Where the hole is has not been measured: drill through the guide first.")
    hole, measured = as_transform(run.data.hole), await measure_coil(run)
    run.result |= {"hole": pose_result(hole), **placement_errors(measured, hole)}
    _refuse_if_off(run, "hole", "where the hole was drilled", "Back off and place it again, with the same nudges.")


def _refuse_if_off(run: Run, kind: str, what: str, advice: str) -> None:
    """Refuse a guide whose errors are over the limits of their kind."""
    limits = run.cell.settings.limits
    shift_mm, turn_deg = run.result["translation_error"] * 1000.0, math.degrees(run.result["rotation_error"])
    limit_mm, limit_deg = limits[f"{kind}_error_mm"], limits[f"{kind}_error_deg"]
    if not (shift_mm <= limit_mm and turn_deg <= limit_deg):
        text = (
            f"The guide is {shift_mm:.2f} mm and {turn_deg:.2f}° from {what}; the limits are {limit_mm:g} mm and "
            f"{limit_deg:g}°. {advice}"
        )
        raise RefusalError("guide_off", text, shift_mm=shift_mm, turn_deg=turn_deg)


def settle(data: PlacementData, states: Mapping[str, str], effects: Sequence[Effect]) -> PlacementData:
    """Remove the hole once no more work is to be done there. Pure.

    Args:
        data: Data of the procedure.
        states: New state of every branch.
        effects: Effects of the commit.
    """
    settled = settle_placement(data, states, effects)
    return settled if states["treatment"] in HOLE_STATES else msgspec.structs.replace(settled, hole=None)


def register(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that the blueprint uses."""
    registry.payload("trajectory", Trajectory)
    registry.payload("confirmation", Confirmation)
    registry.long_check(trajectory_reachable)
    for step in (keep_hole, record_confirmation):
        registry.step(step)
    for world_step in (check_guide_on_plan, check_guide_pose):
        registry.world_step(world_step)
