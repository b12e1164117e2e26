"""Whether the reference still sits on the body where it sat when the landmarks were digitized.

Where the tracker sees a second marker body that is fixed to the patient elsewhere, ``witness``, it is compared with the
reference all the time. Otherwise only a landmark that is touched again can tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.messages import LandmarkPrompt, PoseMessage
from pcmrs.registration.outliers import chi_squared_limit
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_message, as_transform
from pcmrs.workflows.settings import RegistrationSettings
from pcmrs.workflows.touching import touch

Run = AnyRun[Cell, PlacementData]

BODIES = ("body_ref", "witness")
RECENT = 0.5
"""Frames of the two bodies that are older say nothing of now, s."""


@dataclass(frozen=True, slots=True)
class ReferenceShift:
    """How far the reference has moved against the witness: at the witness, m, and rad."""

    translation: float
    rotation: float

    def exceeds(self, settings: RegistrationSettings) -> bool:
        """Whether it is more than tracker and skin explain."""
        turned = math.degrees(self.rotation) > settings.reference_limit_deg
        return turned or self.translation * 1000.0 > settings.reference_limit_mm


def observe_witness(cell: Cell, since: float) -> PoseMessage | None:
    """``body_ref_from_witness`` as seen after `since`, s of the clock; None where both are not seen."""
    try:
        seen = cell.poses.recent(BODIES, cell.settings.registration.samples, since)
    except RefusalError:
        return None
    return as_message(seen["body_ref"].inverse() @ seen["witness"])


def check_reference(cell: Cell, baseline: PoseMessage | None, since: float) -> None:
    """Refuses where the reference is seen to have moved since the baseline; without a witness nobody can tell.

    Raises:
        RefusalError: ``reference_moved``.
    """
    now = observe_witness(cell, since)
    if baseline is None or now is None:
        return
    shift = _shift(as_transform(baseline), as_transform(now))
    if shift.exceeds(cell.settings.registration):
        raise RefusalError("reference_moved", shift_text(shift, cell), **_fields(shift))


def detected_shift(cell: Cell, data: PlacementData) -> ReferenceShift | None:
    """The least shift of the newest frames, where each of them shows that the reference has moved; None otherwise.

    One frame alone may be wrong, as where a marker is half hidden.
    """
    settings = cell.settings.registration
    if data.reference is None:
        return None
    since = cell.clock.monotonic() - RECENT
    frames = cell.poses.together(BODIES, since)[-settings.reference_frames :]
    if len(frames) < settings.reference_frames:
        return None
    baseline = as_transform(data.reference)
    shifts: list[ReferenceShift] = []
    for frame in reversed(frames):
        shifts.append(_shift(baseline, frame["body_ref"].inverse() @ frame["witness"]))
        if not shifts[-1].exceeds(settings):
            return None
    return min(shifts, key=lambda shift: (shift.translation, shift.rotation))


def shift_text(shift: ReferenceShift, cell: Cell) -> str:
    """What has moved how far, which limit, and what to do."""
    limits = cell.settings.registration
    return (
        f"The reference has moved by {shift.translation * 1000:.1f} mm and {math.degrees(shift.rotation):.1f}° against "
        f"the witness since the landmarks were digitized; the limits are {limits.reference_limit_mm:g} mm and "
        f"{limits.reference_limit_deg:g}°. Fix it, and digitize all landmarks again."
    )


async def touch_landmark_again(run: Run) -> None:
    """Touches a digitized landmark once more: ``same`` where two touches explain the difference, else ``moved``.

    Both touches have noise, so that the squared distance over twice the variance of a touch is chi-squared with 3
    degrees of freedom. What has moved may be the reference, or the tip may have been on another landmark: who digitizes
    anew finds out.
    """
    index, settings = run.payload.index, run.cell.settings.registration
    landmark, digitized = run.data.landmarks[index], run.data.complete_digitization()[index]
    prompt = LandmarkPrompt(index=index, name=landmark.name, position_in_image=landmark.position)
    touched = await touch(run, run.cell.pointer.touch(prompt), f"landmark {landmark.name}")
    off = float(np.linalg.norm(touched.point - np.array(digitized)))
    explained = chi_squared_limit(3, settings.false_alarm)
    limit = math.sqrt(2.0 * explained) * settings.retouch_sigma_mm / 1000.0
    run.result |= {"landmark": landmark.name, "distance": off, "limit": limit, "spread": touched.spread}
    run.outcome = "same" if off <= limit else "moved"
    if run.outcome == "moved":
        run.keep(digitized=tuple(None for _ in run.data.landmarks), reference=None)


def _shift(baseline: Transform, now: Transform) -> ReferenceShift:
    return ReferenceShift(distance(baseline, now), rotation_angle(baseline, now))


def _fields(shift: ReferenceShift) -> dict[str, float]:
    return {"translation": shift.translation, "rotation": shift.rotation}


def register_reference_operations(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the name that blueprints use for this step."""
    registry.world_step(touch_landmark_again)
