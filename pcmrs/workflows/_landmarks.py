"""Planning and digitizing of landmarks."""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.messages import LandmarkPrompt
from pcmrs.registration import register_points
from pcmrs.workflows._arguments import check_metres
from pcmrs.workflows._touching import TAKEN, landmark_prompt, touch
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import Digitized, Landmark, PlacementData, Planned, Point, Registered, as_point
from pcmrs.workflows.reference import RECENT, check_reference, observe_witness

Run = AnyRun[Cell, PlacementData]

MIN_LANDMARKS = 3


class LandmarkPlan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `plan_landmarks`.

    Attributes:
        landmarks: Landmarks in the order in which they are touched.
    """

    landmarks: tuple[Landmark, ...]


class LandmarkIndex(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of the operations on one landmark.

    Attributes:
        index: Index of the landmark in the order of the plan, from 0.
    """

    index: int


class LandmarkNames(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `reuse_previous_of`.

    Attributes:
        names: Names of the landmarks whose previous points are kept.
    """

    names: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]


def landmarks_spread(run: Run) -> None:
    """Refuse a plan that no registration could use: too few, in mm, collinear or coincident points."""
    landmarks = run.payload.landmarks
    if len(landmarks) < MIN_LANDMARKS:
        text = f"{len(landmarks)} landmarks are planned; a registration needs at least {MIN_LANDMARKS}."
        raise RefusalError("too_few_landmarks", text, count=len(landmarks), limit=MIN_LANDMARKS)
    points = np.array([landmark.position for landmark in landmarks])
    check_metres(points)
    register_points(points, points)


def keep_landmarks(run: Run) -> None:
    """Store a new plan, which opens all landmarks."""
    landmarks = run.payload.landmarks
    run.keep(landmarks=landmarks, digitized=(None,) * len(landmarks), reference=None)
    run.result["landmarks"] = len(landmarks)


def landmark_exists(run: Run) -> None:
    """Refuse an index that the accepted plan does not have."""
    count = len(run.data.landmarks)
    if not 0 <= run.payload.index < count:
        text = f"Landmark index {run.payload.index} is outside 0 to {count - 1}: {count} landmarks are planned."
        raise RefusalError("no_such_landmark", text, index=run.payload.index, count=count)


async def digitize_every_landmark(run: Run) -> None:
    """Digitize all landmarks in order; either all of them are stored or none.

    Earlier points of the skin are removed.
    """
    count = len(run.data.landmarks)
    run.keep(digitized=(None,) * count, surface=())
    for index in range(count):
        run.progress(index / count)
        await _digitize(run, index)


async def digitize_landmark(run: Run) -> None:
    """Digitize one landmark. The last open one completes the digitization."""
    await _digitize(run, run.payload.index)
    run.outcome = "complete" if run.data.complete_digitization() else "partial"


async def digitize_landmark_again(run: Run) -> None:
    """Replace one landmark of a complete digitization."""
    await _digitize(run, run.payload.index)


def reopen_landmark(run: Run) -> None:
    """Reopen one landmark. The others stay."""
    points = run.data.digitized
    index = run.payload.index
    run.keep(digitized=(*points[:index], None, *points[index + 1 :]))


def previous_digitization_fits(run: Run) -> None:
    """Refuse a previous digitization of other landmarks, patient, calibration or place of the reference."""
    previous = run.data.previous_digitization
    if previous is None:
        raise RefusalError("no_previous_digitization", "No complete digitization was made before: digitize first.")
    if previous.landmarks != run.data.landmarks:
        unchanged = [landmark.name for landmark in run.data.landmarks if landmark in previous.landmarks]
        named = (
            f" Unchanged are {', '.join(unchanged)}: reuse_previous_of keeps those that you name." if unchanged else ""
        )
        text = f"The previous digitization was made for other planned landmarks: digitize the present ones.{named}"
        raise RefusalError("other_landmarks", text, unchanged=unchanged)
    _check_previous(run, previous)


def named_landmarks_unchanged(run: Run) -> None:
    """Refuse to keep points of landmarks that are not planned, are planned elsewhere now, or were not digitized.

    Also refuse all of them if patient, calibration or place of the reference are others, or if other landmarks were
    touched meanwhile with the reference elsewhere.
    """
    previous = run.data.previous_digitization
    if previous is None:
        raise RefusalError("no_previous_digitization", "No complete digitization was made before: digitize first.")
    for name in run.payload.names:
        planned = [landmark for landmark in run.data.landmarks if landmark.name == name]
        if len(planned) != 1:
            text = f"{len(planned)} planned landmarks are called {name!r}: name one that is there once."
            raise RefusalError("no_such_landmark", text, name=name, count=len(planned))
        if previous.landmarks.count(planned[0]) != 1:
            text = f"{name} was not digitized where it is planned now: digitize it, and name the others only."
            raise RefusalError("other_landmarks", text, name=name)
    _check_previous(run, previous)
    if any(_points_kept(run)):
        check_reference(run.cell, run.data.reference, run.clock.monotonic() - RECENT)


def take_previous_points(run: Run) -> None:
    """Restore the previous points of the landmarks that are named; all others stay as they are."""
    previous = run.data.previous_digitization
    if previous is not None:
        points = dict(zip(previous.landmarks, previous.points, strict=True))
        run.keep(reference=previous.reference, surface=())
        named = (points[each] if each.name in run.payload.names else None for each in run.data.landmarks)
        kept = tuple(point or touched for point, touched in zip(named, _points_kept(run), strict=True))
        _keep_digitized(run, kept)
    run.outcome = "complete" if run.data.complete_digitization() else "partial"


def _points_kept(run: Run) -> list[Point | None]:
    """Return the present points of the landmarks that are not named; None for those that are named or open."""
    touched = zip(run.data.landmarks, run.data.digitized, strict=True)
    return [None if landmark.name in run.payload.names else point for landmark, point in touched]


def _check_previous(run: Run, previous: Digitized) -> None:
    check_same_head(run.cell, previous)
    check_reference(run.cell, previous.reference, run.clock.monotonic() - RECENT)


def take_previous_digitization(run: Run) -> None:
    """Restore all points of the previous digitization."""
    previous = run.data.previous_digitization
    if previous is not None:
        run.keep(reference=previous.reference, surface=())
        _keep_digitized(run, previous.points)


def check_same_head(cell: Cell, previous: Digitized | Registered | Planned) -> None:
    """Refuse data of another patient, or data that was made with another calibration or marker body on the patient.

    Args:
        cell: Cell with the settings and calibrations.
        previous: Earlier data.

    Raises:
        RefusalError: ``other_patient``, ``other_calibration`` or ``other_reference``.
    """
    settings, serial = cell.settings, cell.settings.calibration.reference_serial
    if previous.patient != settings.patient:
        text = f"The previous one belongs to patient {previous.patient}, not {settings.patient}: make a new one."
        raise RefusalError("other_patient", text, patient=previous.patient)
    if previous.calibration != cell.calibration_id:
        raise RefusalError("other_calibration", "The calibration has changed since the previous one: make a new one.")
    if previous.reference_serial != serial:
        before, now = (each or "of no serial" for each in (previous.reference_serial, serial))
        text = f"The marker body on the patient was {before} then, and is {now} now: make a new one."
        raise RefusalError("other_reference", text, reference_serial=previous.reference_serial)


async def _digitize(run: Run, index: int) -> None:
    point = await _touch(run, index)
    points = run.data.digitized
    _keep_digitized(run, (*points[:index], point, *points[index + 1 :]))


def _keep_digitized(run: Run, points: tuple[Point | None, ...]) -> None:
    """Store the points, and also as the previous digitization if they are complete."""
    run.keep(digitized=points)
    complete = run.data.complete_digitization()
    if complete:
        cell, landmarks = run.cell, run.data.landmarks
        previous = Digitized(
            landmarks=landmarks,
            points=complete,
            patient=cell.settings.patient,
            calibration=cell.calibration_id,
            reference=run.data.reference,
            reference_serial=cell.settings.calibration.reference_serial,
        )
        run.keep(previous_digitization=previous)
    run.result["digitized"] = sum(point is not None for point in points)


async def _touch(run: Run, index: int) -> Point:
    """Wait for the touch of landmark `index`, and return the tip in body_ref, m.

    The first touch of a digitization also stores the pose of the witness, with which later poses are compared.

    Raises:
        RefusalError: See `touch`; or the reference has moved since the first landmark.
    """
    cell, landmark = run.cell, run.data.landmarks[index]
    prompt = LandmarkPrompt(index=index, name=landmark.name, position_in_image=landmark.position)
    shown = landmark_prompt(landmark, index + 1, len(run.data.landmarks))
    touched = await touch(run, cell.pointer.touch(prompt), f"landmark {landmark.name}", shown)
    if any(point is not None for point in run.data.digitized):
        check_reference(cell, run.data.reference, touched.since)
    else:
        run.keep(reference=observe_witness(cell, touched.since))
    cell.beep(TAKEN)
    run.result.setdefault("spreads", {})[landmark.name] = touched.spread
    return as_point(touched.point)


def register_landmark_operations(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these checks and steps."""
    registry.payload("landmarks", LandmarkPlan)
    registry.payload("landmark_index", LandmarkIndex)
    registry.payload("landmark_names", LandmarkNames)
    for check in (landmarks_spread, landmark_exists, previous_digitization_fits, named_landmarks_unchanged):
        registry.check(check)
    for step in (keep_landmarks, reopen_landmark, take_previous_digitization, take_previous_points):
        registry.step(step)
    for world_step in (digitize_every_landmark, digitize_landmark, digitize_landmark_again):
        registry.world_step(world_step)
