"""Femoroplasty's own checks and steps: the drill trajectory, the surgeon's confirmations, the guide and the hole."""

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
from pcmrs.workflows.arguments import PersonName, check_metres
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Point, as_message, as_transform
from pcmrs.workflows.data import settle as settle_placement
from pcmrs.workflows.motion import measure_coil, placement_errors, pose_result
from pcmrs.workflows.placement import planned
from pcmrs.workflows.toolplan import accept_pose

MIN_LENGTH = 0.005
"""Entry and target nearer than this (m) give no direction worth drilling along."""
MAX_LENGTH = 0.200
"""No femoral neck is so long, m."""
ANTERIOR, SUPERIOR = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
NEARLY_PARALLEL = 0.99

HOLE_STATES = ("drilling", "drilling_interrupted", "drilled", "checked", "injecting", "injecting_interrupted")
"""States of the treatment in which there is a hole, or will be, that work goes on at."""


class Data(PlacementData, frozen=True, kw_only=True):
    """What a femoroplasty gathers.

    Attributes:
        hole: ``image_from_coil`` as measured when the drill went in.
    """

    hole: PoseMessage | None = None


Run = AnyRun[Cell, Data]


class Trajectory(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `plan_trajectory`: where the drill enters the bone and where it is to end, in the image, m."""

    entry: Point
    target: Point


class Confirmation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of what only the surgeon can know: the name of the surgeon who says so."""

    surgeon: PersonName


def guide_pose(entry: Floats, target: Floats) -> Transform:
    """``image_from_coil`` of a guide at the entry of a trajectory.

    The origin is the entry, +z leads from the target to the entry, so away from the body, and +y is as far superior
    as it can be (anterior, where the trajectory itself is superior): a guide is the same however it is turned.
    """
    z = (entry - target) / np.linalg.norm(entry - target)
    up = SUPERIOR if abs(z @ SUPERIOR) < NEARLY_PARALLEL else ANTERIOR
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return Transform(np.column_stack((x, np.cross(z, x), z)), entry)


def trajectory_reachable(run: Run) -> None:
    """Refuses what is no trajectory in a femur, and as soon as that can be decided what the arm cannot reach."""
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
    """Puts on record who confirmed what."""
    run.result |= {"surgeon": run.payload.surgeon, "confirmed": run.command.operation}


async def check_guide_on_plan(run: Run) -> None:
    """Measures the guide by the tracker, and refuses one beside the plan; what was nudged on purpose counts as well.

    Raises:
        RefusalError: An error is over its limit, or the guide is not seen.
    """
    plan, offset = planned(run.data), run.cell.settings.placement.confirm_offset
    run.prepared = measured = await measure_coil(run)
    run.result |= {"planned": pose_result(plan), **placement_errors(measured, plan, offset)}
    _refuse_if_off(run, "guide", "the plan, nudges included", "Back off and place it anew, or plan another trajectory.")


def keep_hole(run: Run) -> None:
    """The hole is where the guide has been measured: nudges and plans do not move it."""
    run.keep(hole=as_message(run.prepared))


async def check_guide_pose(run: Run) -> None:
    """Measures the guide by the tracker, and refuses one that is not where it was when the hole was drilled.

    Raises:
        RefusalError: An error is over its limit, the guide is not seen, or nobody knows where the hole is.
    """
    if run.data.hole is None:
        raise RefusalError("no_hole", "Where the hole is has not been measured: drill through the guide first.")
    hole, measured = as_transform(run.data.hole), await measure_coil(run)
    run.result |= {"hole": pose_result(hole), **placement_errors(measured, hole)}
    _refuse_if_off(run, "hole", "where the hole was drilled", "Back off and place it anew, with the nudges of then.")


def _refuse_if_off(run: Run, kind: str, what: str, advice: str) -> None:
    """Refuses a guide whose errors are over the limits of their kind."""
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
    """Forgets where the hole is once nothing more is to be done there. Pure."""
    settled = settle_placement(data, states, effects)
    return settled if states["treatment"] in HOLE_STATES else msgspec.structs.replace(settled, hole=None)


def register(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that the blueprint uses."""
    registry.payload("trajectory", Trajectory)
    registry.payload("confirmation", Confirmation)
    registry.long_check(trajectory_reachable)
    for step in (keep_hole, record_confirmation):
        registry.step(step)
    for world_step in (check_guide_on_plan, check_guide_pose):
        registry.world_step(world_step)
