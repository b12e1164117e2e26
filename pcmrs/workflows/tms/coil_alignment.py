"""Check of the coil's pose on a head that keeps still, by the tracker's newest frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.errors import RefusalError
from pcmrs.spatial import Transform
from pcmrs.workflows._alignment import BODIES, TrackerFrame, desired_in_body_ref, measured_from_desired
from pcmrs.workflows._correction import size_mm_deg
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_transform
from pcmrs.workflows.settings import StimulationSettings
from pcmrs.workflows.tms.data import Data, Run

MIN_FRAMES = 4
"""Least number of frames that distinguish a speed from noise."""


@dataclass(frozen=True)
class CoilAlignment:
    """Measured pose of the coil and its errors.

    Attributes:
        image_from_coil: Pose of the coil in the newest frame.
        error_mm: Distance from the planned pose, including nudges, mm.
        error_deg: Angle to the planned pose, including nudges, deg.
        body_speed: Speed of the body at the planned pose, m/s.
    """

    image_from_coil: Transform
    error_mm: float
    error_deg: float
    body_speed: float


def coil_on_target(run: Run) -> None:
    """Refuse a pulse if the coil is not at its place, the head moves, or the tracker does not see them."""
    check_coil_alignment(run.cell, run.data)


def check_coil_alignment(cell: Cell, data: Data) -> CoilAlignment:
    """Return the present alignment of the coil, or refuse.

    The state of alignment is not sufficient, because it tolerates a loss of a tenth of a second.

    Args:
        cell: Cell with tracker and settings.
        data: Data of the procedure, with registration and plan.

    Raises:
        RefusalError: ``no_plan``, ``pose_stale``, ``coil_off_target`` or ``head_moves``.
    """
    settings = cell.settings.stimulation
    desired = desired_in_body_ref(cell, data)
    if desired is None or data.registered is None:
        raise RefusalError("no_plan", "There is no registration or no plan: both are needed for a pulse.")
    frames = _fresh_frames(cell, settings)
    error_mm, error_deg = size_mm_deg(measured_from_desired(cell, frames[-1], desired))
    # Negated comparisons here and below refuse nan, too.
    if not (error_mm <= settings.tolerance_mm and error_deg <= settings.tolerance_deg):
        text = (
            f"The coil is {error_mm:.2f} mm and {error_deg:.2f}° from its planned pose; for a pulse the limits are "
            f"{settings.tolerance_mm:g} mm and {settings.tolerance_deg:g}°. Wait until it is there, or place it again."
        )
        raise RefusalError("coil_off_target", text, error_mm=error_mm, error_deg=error_deg)
    speed = _speed(frames, desired)
    if not speed <= settings.body_speed:
        text = (
            f"The head moves at {speed * 1000:.0f} mm/s; for a pulse the limit is {settings.body_speed * 1000:g} mm/s. "
            "Wait until it keeps still."
        )
        raise RefusalError("head_moves", text, speed=speed, limit=settings.body_speed)
    coil, body_ref = (frames[-1][body].tracker_from_body for body in BODIES)
    image_from_body_ref = as_transform(data.registered.body_ref_from_image).inverse()
    image_from_coil = image_from_body_ref @ body_ref.inverse() @ cell.mounting.tool_tip(coil)
    return CoilAlignment(image_from_coil, error_mm, error_deg, speed)


def _fresh_frames(cell: Cell, settings: StimulationSettings) -> list[TrackerFrame]:
    """Return the newest frames, oldest first. Raises `RefusalError` if they are old or too few for a speed."""
    frames = cell.poses.frames_after(0, BODIES)
    if not frames:
        raise RefusalError("pose_stale", "Coil and body have not been seen together: clear the line of sight.")
    newest = frames[-1]["coil"].captured
    age = cell.clock.monotonic() - newest
    recent = [frame for frame in frames if frame["coil"].captured > newest - settings.speed_time]
    if age > settings.pose_age or len(recent) < MIN_FRAMES:
        text = (
            f"Coil and body were last seen together {age:.3f} s ago, and in {len(recent)} frames just before; a pulse "
            f"needs {settings.pose_age:g} s at most and {MIN_FRAMES} frames. Clear the line of sight, or see why "
            "the tracker is slow."
        )
        raise RefusalError("pose_stale", text, age=age, limit=settings.pose_age, frames=len(recent))
    return recent


def _speed(frames: list[TrackerFrame], body_ref_from_desired: Transform) -> float:
    """Return the speed of the planned pose on the body, m/s: the slope of a straight line through its positions."""
    seen = [frame["body_ref"] for frame in frames]
    times = np.array([each.exposed for each in seen])
    places = np.array([each.tracker_from_body @ body_ref_from_desired.translation for each in seen])
    slope, _ = np.polyfit(times - times[0], places, 1)
    return float(np.linalg.norm(slope))


def register_coil_alignment(registry: Registry[Cell, PlacementData]) -> None:
    """Register the name that blueprints use for this check."""
    registry.check(coil_on_target)
