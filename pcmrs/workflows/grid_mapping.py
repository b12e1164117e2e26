"""Going through a grid of stimulation points: which pose is next, and whether the coil is there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Self

import msgspec

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.fsm import Blueprint, Effect
from pcmrs.workflows import data as placement_data
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_message
from pcmrs.workflows.motion import measure_coil, placement_errors, pose_result
from pcmrs.workflows.toolplan import ToolPose, accept_pose, pose_of


class Data(PlacementData, frozen=True, kw_only=True):
    """What a mapping gathers.

    Attributes:
        points: States of the mapping in which a point is next, in order.
        grid: ``image_from_coil`` of each point; empty until a grid is planned.
        performed: Points of the present map at which the coil was, in order.
        skipped: Points of the present map that were left out, in order.
    """

    points: tuple[str, ...] = ()
    grid: tuple[ToolPose, ...] = ()
    performed: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()

    @classmethod
    def begin(cls, blueprint: Blueprint) -> Self:
        return cls(points=tuple(blueprint.branches["mapping"].operations["perform"].from_))


Run = AnyRun[Cell, Data]


class Grid(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `plan_grid`: the pose of the coil at each point, in order."""

    poses: tuple[ToolPose, ...]


def grid_fits(run: Run) -> None:
    """Refuses a grid of another number of points than the workflow has, and what is no pose."""
    poses, expected = run.payload.poses, len(run.data.points)
    if len(poses) != expected:
        text = f"The grid has {len(poses)} poses; this workflow maps {expected} points."
        raise RefusalError("wrong_number_of_points", text, count=len(poses), expected=expected)
    for pose in poses:
        pose_of(pose)


def keep_grid(run: Run) -> None:
    """Puts the grid in force."""
    run.keep(grid=run.payload.poses)
    run.result["points"] = len(run.payload.poses)


def point_reachable(run: Run) -> None:
    """Prepares the pose of the point that is next as the plan; refuses where none is, or the arm cannot reach it."""
    accept_pose(run, pose_of(_next_pose(run)))
    run.result["point"] = run.states["mapping"]


def plan_is_of_point(run: Run) -> None:
    """Refuses to perform a point while the plan in force is of another pose."""
    if run.data.plan != as_message(pose_of(_next_pose(run))):
        text = f"The plan in force is not the pose of {run.states['mapping']}: ask for toolplan.aim, then approach."
        raise RefusalError("other_point_planned", text, point=run.states["mapping"])


async def measure_at_point(run: Run) -> None:
    """Measures the coil by the tracker, and its errors against the pose of the point: nudges do not belong to that."""
    point, offset = pose_of(_next_pose(run)), run.cell.settings.placement.confirm_offset
    errors = placement_errors(await measure_coil(run), point, offset)
    run.result |= {"point": run.states["mapping"], "planned": pose_result(point), **errors}


def point_within_tolerance(run: Run) -> None:
    """Fails a point at which the coil has been measured too far from where it was planned."""
    limits, point = run.cell.settings.limits, run.states["mapping"]
    found = {
        "mm": run.result["translation_error"] * 1000.0,
        "deg": math.degrees(run.result["rotation_error"]),
    }
    for unit, value in found.items():
        limit = limits[f"point_tolerance_{unit}"]
        if not value <= limit:
            text = (
                f"The coil is {value:.2f} {unit} from the planned pose of {point}, to which nudges do not belong; "
                f"the limit is {limit:g} {unit}. Place it anew and repeat the point, or skip it."
            )
            raise RefusalError("point_missed", text, point=point, value=value, limit=limit)


def count_as_performed(run: Run) -> None:
    """Puts on record that the point was performed."""
    run.keep(performed=(*run.data.performed, run.states["mapping"]))
    _report_points(run)


def count_as_skipped(run: Run) -> None:
    """Puts on record that the point, stopped or not, was left out: a map of skipped points is no mapping."""
    run.result["point"] = point = run.states["mapping"].removesuffix("_stopped")
    run.keep(skipped=(*run.data.skipped, point))
    _report_points(run)


def _report_points(run: Run) -> None:
    run.result |= {"performed": list(run.data.performed), "skipped": list(run.data.skipped)}


def settle(data: Data, states: Mapping[str, str], effects: Sequence[Effect]) -> PlacementData:
    """Drops what the joint state no longer stands for; a map that begins anew has no points behind it. Pure."""
    begins = states["mapping"] in ("unplanned", data.points[0])
    fitted = msgspec.structs.replace(data, performed=(), skipped=()) if begins else data
    fitted = msgspec.structs.replace(fitted, grid=()) if states["mapping"] == "unplanned" else fitted
    return placement_data.settle(fitted, states, effects)


def _next_pose(run: Run) -> ToolPose:
    data, state = run.data, run.states["mapping"]
    if state not in data.points:
        text = f"No point is next: the mapping is in {state}. Plan a grid, or repeat or skip a stopped point."
        raise RefusalError("no_next_point", text, state=state)
    return data.grid[data.points.index(state)]


def register(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that the blueprint uses beside those of all procedures."""
    registry.payload("grid", Grid)
    registry.long_check(point_reachable)
    for check in (grid_fits, plan_is_of_point):
        registry.check(check)
    registry.world_step(measure_at_point)
    for step in (keep_grid, point_within_tolerance, count_as_performed, count_as_skipped):
        registry.step(step)
