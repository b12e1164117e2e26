"""Checks of the tool's distance from the body: towards it only as planned, away from it only farther."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Frame, Transform
from pcmrs.workflows._earlier_body import earlier_registration
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

SAMPLE_STRIDE = 8
"""Stride of the checked samples of a trajectory: 40 ms."""

CLEARANCE_RESERVE = 0.010
"""Distance by which a retreat goes beyond the clearance, m."""

TOLERANCE = 0.001
"""A distance that shrinks by less than this is regarded as noise of the measured posture, m."""


def body_centre(cell: Cell, data: PlacementData) -> Floats:
    """Return a point inside the body, in the robot's base, m, (3,): the centre of the last registered landmarks.

    The body is at its present or last seen pose. Until a registration has been seen, its reference is used instead.

    Args:
        cell: Cell with the tracked poses.
        data: Data of the procedure.

    Raises:
        RefusalError: The body has never been seen together with the tool.
    """
    with suppress(RefusalError):
        cell.frames(data)
    if cell.base_from_body_ref is None:
        text = "The body has not been seen yet: show the tool and the body's reference to the tracker."
        raise RefusalError("body_unknown", text)
    if data.registered is not None:
        cell.remember_registered(data.registered)
    if cell.middle_in_body_ref is None:
        return cell.base_from_body_ref.translation
    return cell.base_from_body_ref @ cell.middle_in_body_ref


def _body_centres(cell: Cell, data: PlacementData) -> list[Floats]:
    """Return all points to keep away from, in the robot's base, m, (3,) each: `body_centre` and an earlier one.

    Args:
        cell: Cell with the tracked poses.
        data: Data of the procedure.

    Raises:
        RefusalError: See `body_centre`.
    """
    centre, earlier = body_centre(cell, data), earlier_registration(cell, data)
    if earlier is None or cell.base_from_body_ref is None:
        return [centre]
    return [centre, cell.base_from_body_ref @ earlier.middle_in_body_ref()]


def distance_from_body(cell: Cell, data: PlacementData) -> float:
    """Return the present distance of the coil from the nearest of `_body_centres`, m.

    Args:
        cell: Cell with the tracked poses.
        data: Data of the procedure.

    Raises:
        RefusalError: Tool and body are not seen together.
    """
    base_from_tool_tip = cell.frames(data).get(Frame.ROBOT_BASE, Frame.TOOL_TIP)
    offsets = [base_from_tool_tip.translation - centre for centre in _body_centres(cell, data)]
    return float(min(np.linalg.norm(offset) for offset in offsets))


def distance_until_clear(cell: Cell, data: PlacementData) -> float:
    """Return the distance that the coil must go along its +z axis to be clear of the body, m; 0 if it already is.

    Args:
        cell: Cell with the tracked poses.
        data: Data of the procedure.

    Raises:
        RefusalError: See `body_centre`.
    """
    base_from_tool_tip = cell.arm.forward(cell.posture()) @ cell.flange_from_tool_tip
    radius = cell.settings.placement.clearance + CLEARANCE_RESERVE
    return max(_distance_until_clear(base_from_tool_tip, centre, radius) for centre in _body_centres(cell, data))


def _distance_until_clear(base_from_tool_tip: Transform, centre: Floats, radius: float) -> float:
    """Return the distance along +z until the coil is `radius` from a point, m."""
    offset = base_from_tool_tip.translation - centre
    outwards = float(offset @ base_from_tool_tip.rotation[:, 2])
    # The root of |offset + length z| = radius that lies ahead.
    inside = radius**2 - float(offset @ offset)
    return max(0.0, -outwards + math.sqrt(outwards**2 + inside)) if inside > 0.0 else 0.0


def check_ends_clear(cell: Cell, trajectory: JointTrajectory, data: PlacementData) -> None:
    """Refuse a path that does not end clear of the body.

    Args:
        cell: Cell with the tracked poses.
        trajectory: Planned path.
        data: Data of the procedure.

    Raises:
        RefusalError: ``not_clear``.
    """
    end = min(float(_body_distances(cell, trajectory, centre)[-1]) for centre in _body_centres(cell, data))
    clearance = cell.settings.placement.clearance
    if end <= clearance:
        text = (
            f"The path would end {end * 1000:.0f} mm from the middle of the body, which is not clear of it "
            f"(more than {clearance * 1000:.0f} mm). Choose another posture."
        )
        raise RefusalError("not_clear", text, distance=end, limit=clearance)


def _body_distances(cell: Cell, trajectory: JointTrajectory, centre: Floats) -> Floats:
    """Return the distance of the coil from a point along a trajectory, m, (K,).

    Args:
        cell: Cell with the arm and the tool's calibration.
        trajectory: Planned path.
        centre: Point in the robot's base, m, (3,).
    """
    samples = [*trajectory.positions[::SAMPLE_STRIDE], trajectory.positions[-1]]
    coils = [(cell.arm.forward(q) @ cell.flange_from_tool_tip).translation for q in samples]
    return np.asarray(np.linalg.norm(np.array(coils) - centre, axis=1))


def check_only_grows(
    cell: Cell, trajectory: JointTrajectory, data: PlacementData, advice: str = "Back off first."
) -> None:
    """Refuse a retreat that comes nearer to the body, unless it stays clear of it all the way.

    Args:
        cell: Cell with the tracked poses.
        trajectory: Planned path.
        data: Data of the procedure.
        advice: Remedy for the error text.

    Raises:
        RefusalError: The path comes nearer than `clearance`, and by more than `TOLERANCE`.
    """
    for centre in _body_centres(cell, data):
        _check_only_grows(cell, _body_distances(cell, trajectory, centre), advice)


def _check_only_grows(cell: Cell, distances: Floats, advice: str) -> None:
    # The loss of distance against the farthest point so far.
    shrinks = np.maximum.accumulate(distances) - distances
    worst = int(np.argmax(np.where(distances < cell.settings.placement.clearance, shrinks, 0.0)))
    if distances[worst] < cell.settings.placement.clearance and shrinks[worst] > TOLERANCE:
        text = (
            f"The path leads back towards the body: to {distances[worst] * 1000:.0f} mm from its middle after "
            f"{(distances[worst] + shrinks[worst]) * 1000:.0f} mm. {advice}"
        )
        raise RefusalError("distance_shrinks", text, distance=float(distances[worst]), shrinks=float(shrinks[worst]))


def check_passes_clear(cell: Cell, trajectory: JointTrajectory, data: PlacementData) -> None:
    """Refuse an approach that comes nearer to the body on its way than at its end.

    Args:
        cell: Cell with the tracked poses.
        trajectory: Planned path.
        data: Data of the procedure.

    Raises:
        RefusalError: It comes nearer by more than 10 mm.
    """
    distances = _body_distances(cell, trajectory, body_centre(cell, data))
    nearest, end = float(distances.min()), float(min(distances[0], distances[-1]))
    if nearest < end - 0.010:
        text = (
            f"The path to the standoff passes the body at {nearest * 1000:.0f} mm from its middle, nearer than its "
            f"end ({end * 1000:.0f} mm). Go home first, or plan another pose."
        )
        raise RefusalError("path_near_body", text, distance=nearest, limit=end)


def along_axis(distance: float) -> Transform:
    """Return ``tool_tip_from_shifted`` of a shift along the tool's +z axis, away from the body, m."""
    return Transform(np.eye(3), np.array([0.0, 0.0, distance]))
