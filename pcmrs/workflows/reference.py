"""Check that the reference still sits on the body where it was when the landmarks were digitized.

If the tracker sees a second marker body, the ``witness``, which is fixed to the patient elsewhere, it is compared with
the reference continuously. Otherwise only a second touch of a landmark can detect a shift.
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
from pcmrs.workflows._touching import TAKEN, landmark_prompt, touch
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_message, as_transform
from pcmrs.workflows.settings import RegistrationSettings

Run = AnyRun[Cell, PlacementData]

BODIES = ("body_ref", "witness")
RECENT = 0.5
"""Greatest age of frames of the two bodies that show their present poses, s."""


@dataclass(frozen=True, slots=True)
class ReferenceShift:
    """Shift of the reference against the witness.

    Attributes:
        translation: Translation at the witness, m.
        rotation: Angle of rotation, rad.
    """

    translation: float
    rotation: float

    def exceeds(self, settings: RegistrationSettings) -> bool:
        """Return True if the shift is larger than tracker and skin explain."""
        turned = math.degrees(self.rotation) > settings.reference_limit_deg
        return turned or self.translation * 1000.0 > settings.reference_limit_mm


def observe_witness(cell: Cell, since: float) -> PoseMessage | None:
    """Return ``body_ref_from_witness``; None if both are not seen.

    Args:
        cell: Cell with the tracked poses.
        since: Earliest capture time of the frames, s of the clock.
    """
    try:
        seen = cell.poses.recent(BODIES, cell.settings.registration.samples, since)
    except RefusalError:
        return None
    return as_message(seen["body_ref"].inverse() @ seen["witness"])


def check_reference(cell: Cell, baseline: PoseMessage | None, since: float) -> None:
    """Refuse if the reference has visibly moved since the baseline. Without a witness this cannot be checked.

    Args:
        cell: Cell with the tracked poses.
        baseline: Earlier ``body_ref_from_witness``; None if no witness was seen.
        since: Earliest capture time of the present frames, s of the clock.

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
    """Return the least shift of the newest frames if each of them shows that the reference has moved; otherwise None.

    A single frame may be wrong, for example if a marker is partly hidden.

    Args:
        cell: Cell with the tracked poses.
        data: Data of the procedure with the baseline.
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
    # The newest first, because a frame without a shift ends the loop.
    for frame in reversed(frames):
        shifts.append(_shift(baseline, frame["body_ref"].inverse() @ frame["witness"]))
        if not shifts[-1].exceeds(settings):
            return None
    return min(shifts, key=lambda shift: (shift.translation, shift.rotation))


def shift_text(shift: ReferenceShift, cell: Cell) -> str:
    """Return a text with the shift, its limits and the remedy.

    Args:
        shift: Shift of the reference.
        cell: Cell with the limits.
    """
    limits = cell.settings.registration
    return (
        f"The reference has moved by {shift.translation * 1000:.1f} mm and {math.degrees(shift.rotation):.1f}° against "
        f"the witness since the landmarks were digitized; the limits are {limits.reference_limit_mm:g} mm and "
        f"{limits.reference_limit_deg:g}°. Fix it, and digitize all landmarks again."
    )


async def touch_landmark_again(run: Run) -> None:
    """Touch a digitized landmark again: ``same`` if noise explains the difference, otherwise ``moved``.

    Both touches have noise, so that the squared distance over twice the variance of a touch is chi-squared with 3
    degrees of freedom. Either the reference has moved, or the tip was on another landmark. A new digitization shows
    which.
    """
    index, settings = run.payload.index, run.cell.settings.registration
    landmark, digitized = run.data.landmarks[index], run.data.complete_digitization()[index]
    prompt = LandmarkPrompt(index=index, name=landmark.name, position_in_image=landmark.position)
    shown = landmark_prompt(landmark, index + 1, len(run.data.landmarks))
    touched = await touch(run, run.cell.pointer.touch(prompt), f"landmark {landmark.name}", shown)
    run.cell.beep(TAKEN)
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
    """Register the name that blueprints use for this step."""
    registry.world_step(touch_landmark_again)
