"""Planning, digitizing and registering landmarks."""

from __future__ import annotations

from contextlib import suppress

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.messages import LandmarkPrompt
from pcmrs.registration import register_points
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import Digitized, Landmark, PlacementData, Point, Registered, as_message, as_point

Run = AnyRun[Cell, PlacementData]

FEWEST_LANDMARKS = 3
FARTHEST_LANDMARK = 1.0
"""A landmark farther than this from the origin of the image (m) was probably given in mm."""


class LandmarkPlan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `plan_landmarks`."""

    landmarks: tuple[Landmark, ...]


class LandmarkIndex(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of the operations on one landmark; `index` counts from 0 in the order of the plan."""

    index: int


def landmarks_spread(run: Run) -> None:
    """Refuses a plan that no registration could use: too few, in mm, collinear or coincident points."""
    landmarks = run.payload.landmarks
    if len(landmarks) < FEWEST_LANDMARKS:
        text = f"{len(landmarks)} landmarks are planned; a registration needs at least {FEWEST_LANDMARKS}."
        raise RefusalError("too_few_landmarks", text, count=len(landmarks), limit=FEWEST_LANDMARKS)
    points = np.array([landmark.position for landmark in landmarks])
    farthest = float(np.abs(points).max())
    if farthest > FARTHEST_LANDMARK:
        text = f"A coordinate is {farthest:g} m; the limit is {FARTHEST_LANDMARK:g} m. Were these millimetres?"
        raise RefusalError("wrong_unit", text, value=farthest, limit=FARTHEST_LANDMARK)
    register_points(points, points)


def keep_landmarks(run: Run) -> None:
    """A new plan opens all landmarks."""
    landmarks = run.payload.landmarks
    run.keep(landmarks=landmarks, digitized=tuple(None for _ in landmarks))
    run.result["landmarks"] = len(landmarks)


def landmark_exists(run: Run) -> None:
    """Refuses an index that the accepted plan does not have."""
    count = len(run.data.landmarks)
    if not 0 <= run.payload.index < count:
        text = f"Landmark index {run.payload.index} is outside 0 to {count - 1}: {count} landmarks are planned."
        raise RefusalError("no_such_landmark", text, index=run.payload.index, count=count)


async def digitize_every_landmark(run: Run) -> None:
    """Digitizes all landmarks in order; all of them, or none is kept."""
    points: list[Point] = []
    count = len(run.data.landmarks)
    for index in range(count):
        run.progress(index / count)
        points.append(await _touch(run, index))
    _keep_digitized(run, tuple(points))


async def digitize_landmark(run: Run) -> None:
    """Digitizes one landmark; the last open one completes the digitization."""
    await _digitize(run, run.payload.index)
    run.outcome = "complete" if run.data.complete_digitization() else "partial"


async def digitize_landmark_again(run: Run) -> None:
    """Replaces one landmark of a complete digitization."""
    await _digitize(run, run.payload.index)


def reopen_landmark(run: Run) -> None:
    """Opens one landmark; the others stay."""
    points = run.data.digitized
    index = run.payload.index
    run.keep(digitized=(*points[:index], None, *points[index + 1 :]))


def previous_digitization_fits(run: Run) -> None:
    """Refuses a previous digitization of other landmarks, of another patient or with another calibration."""
    previous = run.data.previous_digitization
    if previous is None:
        raise RefusalError("no_previous_digitization", "No complete digitization was made before: digitize first.")
    if previous.landmarks != run.data.landmarks:
        text = "The previous digitization was made for other planned landmarks: digitize the present ones."
        raise RefusalError("other_landmarks", text)
    _check_same_head(run, previous.patient, previous.calibration)


def take_previous_digitization(run: Run) -> None:
    """Takes all points of the previous digitization."""
    previous = run.data.previous_digitization
    _keep_digitized(run, previous.points if previous is not None else ())


def residual_within_limit(run: Run) -> None:
    """Registers, and refuses when the mean distance of the landmarks is over the limit."""
    data = run.data
    fixed = np.array(data.complete_digitization())
    moving = np.array([landmark.position for landmark in data.landmarks])
    fit = register_points(fixed, moving)
    limit = run.cell.settings.registration.residual_limit_mm / 1000.0
    run.result |= {"residual": fit.residual, "rms": fit.rms, "distances": fit.distances.tolist(), "limit": limit}
    if not fit.residual <= limit:
        worst = data.landmarks[int(np.argmax(fit.distances))].name
        text = (
            f"The registration residual is {fit.residual * 1000:.2f} mm, the limit is {limit * 1000:.2f} mm; "
            f"the largest deviation is at {worst}. Digitize again."
        )
        raise RefusalError("residual_too_large", text, residual=fit.residual, limit=limit, worst=worst)
    run.prepared = fit


def keep_registration(run: Run) -> None:
    """Puts the registration in force."""
    data, fit = run.data, run.prepared
    registered = Registered(
        id=f"registration-{run.command.id}",
        body_ref_from_image=as_message(fit.fixed_from_moving),
        residual=fit.residual,
        rms=fit.rms,
        landmarks=data.landmarks,
        digitized=data.complete_digitization(),
        patient=run.cell.settings.patient,
        calibration=run.cell.calibration_id,
    )
    run.keep(registered=registered, registration_id=registered.id, previous=registered)


def previous_registration_fits(run: Run) -> None:
    """Refuses a previous registration of another patient or made with another calibration."""
    previous = run.data.previous
    if previous is None:
        raise RefusalError("no_previous_registration", "No registration was accepted before: register first.")
    _check_same_head(run, previous.patient, previous.calibration)


def _check_same_head(run: Run, patient: str, calibration: str) -> None:
    settings = run.cell.settings
    if patient != settings.patient:
        text = f"The previous one belongs to patient {patient}, not {settings.patient}: make a new one."
        raise RefusalError("other_patient", text, patient=patient)
    if calibration != run.cell.calibration_id:
        raise RefusalError("other_calibration", "The calibration has changed since the previous one: make a new one.")


def take_previous_registration(run: Run) -> None:
    """Puts the previous registration in force, with the landmarks it rests on."""
    previous = run.data.previous
    if previous is None:
        raise RefusalError("no_previous_registration", "No registration was accepted before: register first.")
    registered = msgspec.structs.replace(previous, id=f"registration-{run.command.id}")
    run.keep(
        registered=registered,
        registration_id=registered.id,
        previous=registered,
        landmarks=previous.landmarks,
        digitized=previous.digitized,
    )
    run.result["residual"] = previous.residual


async def _digitize(run: Run, index: int) -> None:
    point = await _touch(run, index)
    points = run.data.digitized
    _keep_digitized(run, (*points[:index], point, *points[index + 1 :]))


def _keep_digitized(run: Run, points: tuple[Point | None, ...]) -> None:
    run.keep(digitized=points)
    complete = run.data.complete_digitization()
    if complete:
        cell, landmarks = run.cell, run.data.landmarks
        previous = Digitized(
            landmarks=landmarks, points=complete, patient=cell.settings.patient, calibration=cell.calibration_id
        )
        run.keep(previous_digitization=previous)
    run.result["digitized"] = sum(point is not None for point in points)


async def _touch(run: Run, index: int) -> Point:
    """Has landmark `index` touched and returns the tip in body_ref, m: the mean of fresh samples.

    Raises:
        RefusalError: Pointer or reference are not seen, or the samples spread too far.
    """
    cell, settings = run.cell, run.cell.settings.registration
    landmark = run.data.landmarks[index]
    prompt = LandmarkPrompt(index=index, name=landmark.name, position_in_image=landmark.position)
    try:
        async with run.clock.timeout(settings.touch_timeout_s):
            await cell.pointer.touch(prompt)
        frames = await cell.poses.collect(["body_ref", "pointer"], settings.samples, timeout=5.0)
    except TimeoutError:
        text = f"Landmark {landmark.name} was not touched within {settings.touch_timeout_s:g} s."
        raise RefusalError("landmark_not_touched", text, index=index) from None
    finally:
        with suppress(PcmrsError):  # the touch's own failure is the one to report
            await cell.pointer.release()
    tip = cell.pointer_from_tip.translation
    tips = np.array([frame["body_ref"].inverse() @ (frame["pointer"] @ tip) for frame in frames])
    spread = float(np.sqrt(np.mean(np.sum((tips - tips.mean(axis=0)) ** 2, axis=1))))
    limit = settings.spread_limit_mm / 1000.0
    if not spread <= limit:
        text = (
            f"The samples of landmark {landmark.name} spread {spread * 1000:.2f} mm, the limit is "
            f"{limit * 1000:.2f} mm. Hold the pointer still and digitize it again."
        )
        raise RefusalError("spread_too_large", text, index=index, spread=spread, limit=limit)
    return as_point(tips.mean(axis=0))


def register_landmark_operations(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for these checks and steps."""
    registry.payload("landmarks", LandmarkPlan)
    registry.payload("landmark_index", LandmarkIndex)
    for check in (landmarks_spread, landmark_exists, previous_digitization_fits):
        registry.check(check)
    for check in (residual_within_limit, previous_registration_fits):
        registry.check(check)
    for step in (keep_landmarks, reopen_landmark, take_previous_digitization):
        registry.step(step)
    for step in (keep_registration, take_previous_registration):
        registry.step(step)
    for world_step in (digitize_every_landmark, digitize_landmark, digitize_landmark_again):
        registry.world_step(world_step)
