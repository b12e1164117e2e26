"""Going through a grid of stimulation points: which pose is next, and whether the coil is there."""

from __future__ import annotations

import math
from typing import Self

import msgspec

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.fsm import Blueprint
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_message
from pcmrs.workflows.toolplan import ToolPose, accept_pose, pose_of


class Data(PlacementData, frozen=True, kw_only=True):
    """What a mapping gathers.

    Attributes:
        points: States of the mapping in which a point is next, in order.
        grid: ``image_from_coil`` of each point; empty until a grid is planned.
    """

    points: tuple[str, ...] = ()
    grid: tuple[ToolPose, ...] = ()

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


def point_within_tolerance(run: Run) -> None:
    """Fails a point at which the coil has been measured too far from where it was planned."""
    limits = run.cell.settings.limits
    found = {
        "mm": run.result["translation_error"] * 1000.0,
        "deg": math.degrees(run.result["rotation_error"]),
    }
    run.result["point"] = run.states["mapping"]
    for unit, value in found.items():
        limit = limits[f"point_tolerance_{unit}"]
        if not value <= limit:
            text = f"The coil is {value:.2f} {unit} from the planned pose of the point; the limit is {limit:g} {unit}."
            raise RefusalError("point_missed", text, point=run.states["mapping"], value=value, limit=limit)


def _next_pose(run: Run) -> ToolPose:
    data, state = run.data, run.states["mapping"]
    if state not in data.points:
        text = f"No point is next: the mapping is in {state}. Repeat or skip the point, or plan a grid."
        raise RefusalError("no_next_point", text, state=state)
    if not data.grid:
        raise RefusalError("no_grid", "No grid is planned: ask for mapping.plan_grid first.")
    return data.grid[data.points.index(state)]


def register(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that the blueprint uses beside those of all procedures."""
    registry.payload("grid", Grid)
    for check in (grid_fits, point_reachable, plan_is_of_point):
        registry.check(check)
    for step in (keep_grid, point_within_tolerance):
        registry.step(step)
