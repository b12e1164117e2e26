"""Femoroplasty's own checks and steps: the drill trajectory, the surgeon's confirmations, the check of the guide."""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Point
from pcmrs.workflows.motion import measure_placement
from pcmrs.workflows.toolplan import FARTHEST_TARGET, accept_pose

Run = AnyRun[Cell, PlacementData]

SHORTEST_TRAJECTORY = 0.005
"""Entry and target nearer than this (m) give no direction worth drilling along."""
LONGEST_TRAJECTORY = 0.200
"""No femoral neck is so long, m."""
ANTERIOR, SUPERIOR = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
NEARLY_PARALLEL = 0.99


class Trajectory(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `plan_trajectory`: where the drill enters the bone and where it is to end, in the image, m."""

    entry: Point
    target: Point


class Confirmation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of what only the surgeon can know: the name of the surgeon who says so."""

    surgeon: Annotated[str, msgspec.Meta(min_length=1, max_length=100, pattern=r"\S")]


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
    farthest = float(np.abs((entry, target)).max())
    if farthest > FARTHEST_TARGET:
        text = f"A coordinate is {farthest:g} m; the limit is {FARTHEST_TARGET:g} m. Were these millimetres?"
        raise RefusalError("wrong_unit", text, value=farthest, limit=FARTHEST_TARGET)
    run.result["length"] = length = float(np.linalg.norm(entry - target))
    if not SHORTEST_TRAJECTORY <= length <= LONGEST_TRAJECTORY:
        text = (
            f"Entry and target are {length * 1000:.1f} mm apart; a trajectory has {SHORTEST_TRAJECTORY * 1000:g} to "
            f"{LONGEST_TRAJECTORY * 1000:g} mm. Pick both points in the same bone."
        )
        limits = [SHORTEST_TRAJECTORY, LONGEST_TRAJECTORY]
        raise RefusalError("bad_trajectory", text, length=length, limits=limits)
    accept_pose(run, guide_pose(entry, target))


def record_confirmation(run: Run) -> None:
    """Puts on record who confirmed what."""
    run.result |= {"surgeon": run.payload.surgeon, "confirmed": run.command.operation}


async def check_guide_pose(run: Run) -> None:
    """Measures the guide by the tracker, and refuses one that is not where it was planned.

    Raises:
        RefusalError: An error is over its limit.
    """
    await measure_placement(run)
    limits = run.cell.settings.limits
    shift_mm, turn_deg = run.result["translation_error"] * 1000.0, math.degrees(run.result["rotation_error"])
    limit_mm, limit_deg = limits["guide_error_mm"], limits["guide_error_deg"]
    if not (shift_mm <= limit_mm and turn_deg <= limit_deg):
        text = (
            f"The guide is {shift_mm:.2f} mm and {turn_deg:.2f}° from the plan; the limits are {limit_mm:g} mm and "
            f"{limit_deg:g}°. Back off and place it anew."
        )
        raise RefusalError("guide_off", text, shift_mm=shift_mm, turn_deg=turn_deg)


def register(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that the blueprint uses."""
    registry.payload("trajectory", Trajectory)
    registry.payload("confirmation", Confirmation)
    registry.check(trajectory_reachable)
    registry.step(record_confirmation)
    registry.world_step(check_guide_pose)
