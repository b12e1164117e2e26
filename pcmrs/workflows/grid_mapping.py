"""Mapping of a grid of stimulation points: the next pose, and the check that the coil is there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import msgspec

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.fsm import Effect
from pcmrs.workflows import data as placement_data
from pcmrs.workflows._motion import measure_coil, placement_errors, pose_result
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_message
from pcmrs.workflows.toolplan import ToolPose, accept_pose, pose_of


class Data(PlacementData, frozen=True, kw_only=True):
    """Data of a mapping.

    Attributes:
        grid: ``image_from_coil`` of each point; empty until a grid is planned.
        next_point: Index of the point that is next, from 0.
        performed: Points of the present map that were performed, in order.
        skipped: Points of the present map that were skipped, in order.
    """

    grid: tuple[ToolPose, ...] = ()
    next_point: int = 0
    performed: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()

    @property
    def point(self) -> str:
        """Name of the point that is next, counted from 1."""
        return f"point_{self.next_point + 1}"


Run = AnyRun[Cell, Data]


MOST_POINTS = 1000
"""Largest number of points of a grid."""


class Grid(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `plan_grid`.

    Attributes:
        poses: Pose of the coil at each point, in order.
    """

    poses: Annotated[tuple[ToolPose, ...], msgspec.Meta(min_length=1, max_length=MOST_POINTS)]


def grid_fits(run: Run) -> None:
    """Refuse a grid with an invalid pose."""
    for pose in run.payload.poses:
        pose_of(pose)


def keep_grid(run: Run) -> None:
    """Put the grid in force; its first point is next."""
    run.keep(grid=run.payload.poses, next_point=0, performed=(), skipped=())
    run.result["points"] = len(run.payload.poses)


def point_reachable(run: Run) -> None:
    """Prepare the pose of the next point as the plan, or refuse if there is none or the arm cannot reach it."""
    accept_pose(run, pose_of(_next_pose(run)))
    run.result["point"] = run.data.point


def plan_is_of_point(run: Run) -> None:
    """Refuse to perform a point while the plan in force is of another pose."""
    if run.data.plan != as_message(pose_of(_next_pose(run))):
        text = f"The plan in force is not the pose of {run.data.point}: send toolplan.aim, then approach."
        raise RefusalError("other_point_planned", text, point=run.data.point)


async def measure_at_point(run: Run) -> None:
    """Measure the coil by the tracker, and its errors against the pose of the point without nudges."""
    point, offset = pose_of(_next_pose(run)), run.cell.settings.placement.confirm_offset
    errors = placement_errors(await measure_coil(run), point, offset)
    run.result |= {"point": run.data.point, "planned": pose_result(point), **errors}


def point_within_tolerance(run: Run) -> None:
    """Fail a point at which the coil was measured too far from the planned pose."""
    limits, point = run.cell.settings.limits, run.data.point
    found = {
        "mm": run.result["translation_error"] * 1000.0,
        "deg": math.degrees(run.result["rotation_error"]),
    }
    for unit, value in found.items():
        limit = limits[f"point_tolerance_{unit}"]
        if not value <= limit:
            text = (
                f"The coil is {value:.2f} {unit} from the planned pose of {point}, which does not include nudges; "
                f"the limit is {limit:g} {unit}. Place it again and repeat the point, or skip it."
            )
            raise RefusalError("point_missed", text, point=point, value=value, limit=limit)


def count_as_performed(run: Run) -> None:
    """Put on record that the point was performed, and go on to the next."""
    run.keep(performed=(*run.data.performed, run.data.point))
    _go_on(run)


def count_as_skipped(run: Run) -> None:
    """Put on record that the point, stopped or not, was skipped, because a map of skipped points is not a mapping."""
    run.result["point"] = run.data.point
    run.keep(skipped=(*run.data.skipped, run.data.point))
    _go_on(run)


def _go_on(run: Run) -> None:
    """Let the next point be next, if there is one."""
    run.keep(next_point=run.data.next_point + 1)
    run.outcome = "next" if run.data.next_point < len(run.data.grid) else "last"
    run.result |= {"performed": list(run.data.performed), "skipped": list(run.data.skipped)}
    run.result["points"] = len(run.data.grid)


def settle(data: Data, states: Mapping[str, str], effects: Sequence[Effect]) -> PlacementData:
    """Remove the data that the joint state no longer supports. A map that restarts has no finished points. Pure.

    Args:
        data: Data of the mapping.
        states: New state of every branch.
        effects: Effects of the commit.
    """
    fitted = data
    if any(effect.kind == "revoke" and effect.branch == "mapping" for effect in effects):
        fitted = msgspec.structs.replace(data, next_point=0, performed=(), skipped=())
    if states["mapping"] == "unplanned":
        fitted = msgspec.structs.replace(data, grid=(), next_point=0, performed=(), skipped=())
    return placement_data.settle(fitted, states, effects)


def _next_pose(run: Run) -> ToolPose:
    data, state = run.data, run.states["mapping"]
    if state != "ready":
        text = f"No point is next: the mapping is {state}. Plan a grid, or repeat or skip a stopped point."
        raise RefusalError("no_next_point", text, state=state)
    return data.grid[data.next_point]


def register(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that the blueprint uses in addition to those of all procedures."""
    registry.payload("grid", Grid)
    registry.long_check(point_reachable)
    for check in (grid_fits, plan_is_of_point):
        registry.check(check)
    registry.world_step(measure_at_point)
    for step in (keep_grid, point_within_tolerance, count_as_performed, count_as_skipped):
        registry.step(step)
