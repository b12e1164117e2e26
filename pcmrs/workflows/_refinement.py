"""Points of the skin, and the registration that they refine."""

from __future__ import annotations

from contextlib import suppress
from pathlib import PureWindowsPath
from typing import Annotated, Any

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import ConfigurationError, PcmrsError, RefusalError
from pcmrs.formats.mesh import Mesh
from pcmrs.messages import TouchPrompt
from pcmrs.registration.coverage import SurfaceCoverage, surface_coverage
from pcmrs.registration.surface import refine_with_surface
from pcmrs.workflows._registering import activate_registration, judge_landmarks
from pcmrs.workflows._touching import AWAITED, CLOUD_TAKEN, TAKEN, touch
from pcmrs.workflows.accuracy import learn_noise
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Point, as_point
from pcmrs.workflows.reference import check_reference
from pcmrs.workflows.surface import read_surface

Run = AnyRun[Cell, PlacementData]

HELPED_BY_POINTS = ("too_few_surface_points", "surface_flat", "tre_not_lowered")
"""Refusals of a refinement after which more points in the right region help."""


POINT_SPACING = 0.002
"""Least distance of two points from a sliding tip, m: a tip that rests adds none."""
SLIDE_TIME = 120.0
"""Longest time for the points of a sliding tip, s."""
LOOK_PERIOD = 0.1
"""Time between two looks at the newest frames of a sliding tip, s."""


class SurfacePoints(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `digitize_surface`.

    Attributes:
        points: Number of points to touch, one after the other.
        slide: True to take them from a tip that slides over the skin, False for single touches.
    """

    points: Annotated[int, msgspec.Meta(ge=1, le=500)] = 1
    slide: bool = False


class SurfaceName(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `refine`.

    Attributes:
        surface: Base name of the surface's file; None for the configured one.
    """

    surface: str | None = None


async def digitize_surface_points(run: Run) -> None:
    """Digitize points of the skin, by single touches or by a tip that slides; either all of them are stored or none."""
    points = await (_slide(run) if run.payload.slide else _touch_each(run))
    run.cell.beep(CLOUD_TAKEN)
    run.keep(surface=(*run.data.surface, *points))
    _report_count(run)


async def _touch_each(run: Run) -> list[Point]:
    count, points, before = run.payload.points, list[Point](), len(run.data.surface)
    for number in range(count):
        run.progress(number / count)
        target = f"point {before + number + 1} of the skin"
        text = f"Touch point {number + 1} of {count} anywhere on the skin, 10 mm from the last one: hold the tip still."
        prompt = TouchPrompt(text=text, landmark="", number=number + 1, count=count)
        touched = await touch(run, run.cell.pointer.touch_surface(), target, prompt)
        check_reference(run.cell, run.data.reference, touched.since)
        points.append(as_point(touched.point))
    return points


async def _slide(run: Run) -> list[Point]:
    """Take points of the skin from a tip that slides over it.

    Raises:
        RefusalError: The tip does not touch the skin in time, it slides too slowly or is not seen, or the reference has
            moved.
    """
    cell, count, points = run.cell, run.payload.points, list[Point]()
    text = f"Hold the tip still on the skin; after 2 beeps slide it on until 5 beeps: {count} points are taken."
    run.prompt(TouchPrompt(text=text, landmark="", number=1, count=count))
    cell.beep(AWAITED)
    try:
        async with run.clock.timeout(cell.settings.registration.touch_timeout_s):
            await cell.pointer.slide()
        since = run.clock.monotonic()
        cell.beep(TAKEN)
        async with run.clock.timeout(SLIDE_TIME):
            while len(points) < count:
                await run.clock.sleep(LOOK_PERIOD)
                _take_points(cell, since, points, count)
                run.progress(len(points) / count)
    except TimeoutError:
        text = (
            f"{len(points)} of {count} points of the skin were taken in time. Slide the tip over the skin, where the "
            "tracker sees pointer and reference, and send the command again."
        )
        raise RefusalError("cloud_incomplete", text, count=len(points), wanted=count) from None
    finally:
        run.prompt(None)
        with suppress(PcmrsError):  # the failure itself is the one to report
            await cell.pointer.release()
    check_reference(cell, run.data.reference, since)
    return points


def _take_points(cell: Cell, since: float, points: list[Point], count: int) -> None:
    """Add those positions of the tip that are far enough from all that were taken.

    Args:
        cell: Cell with the tracked poses.
        since: Earliest capture time, s of the clock.
        points: Points taken so far, in body_ref, m.
        count: Number of points that are wanted.
    """
    tip = cell.pointer_from_tip.translation
    for frame in cell.poses.together(["body_ref", "pointer"], since):
        point = frame["body_ref"].inverse() @ (frame["pointer"] @ tip)
        taken = np.array(points).reshape(-1, 3)
        if len(points) < count and not np.any(np.linalg.norm(taken - point, axis=1) < POINT_SPACING):
            points.append(as_point(point))


def surface_point_there(run: Run) -> None:
    """Refuse if no point of the skin can be cleared."""
    if not run.data.surface:
        raise RefusalError("no_surface_points", "No point of the skin has been digitized: there is none to clear.")


def drop_last_surface_point(run: Run) -> None:
    """Remove the point that was touched last."""
    run.keep(surface=run.data.surface[:-1])
    _report_count(run)


def drop_surface_points(run: Run) -> None:
    """Remove all points of the skin."""
    run.keep(surface=())
    _report_count(run)


def surface_refines(run: Run) -> None:
    """Register the landmarks, refine the registration by the points of the skin, and refuse one that is not better.

    Raises:
        RefusalError: A gate of the landmarks' registration does not pass, there is no such surface, or a refusal of
            `refine_with_surface` such as ``tre_not_lowered``.
    """
    fit, report = judge_landmarks(run)
    data, settings = run.data, run.cell.settings.registration
    mesh = _surface(run)
    measured: dict[str, Any] = {
        "landmarks_image": np.array([landmark.position for landmark in data.landmarks]),
        "landmarks_body_ref": data.complete_digitization(),
        "sigma": report["sigma"],
        "vertices": mesh.vertices,
        "faces": mesh.faces,
        "points_body_ref": np.array(data.surface).reshape(-1, 3),
        "sigma_surface": settings.surface_sigma_mm / 1000.0,
        "target": report["target"]["position"],
        "trim": settings.surface_trim,
        "offsets": settings.offset_priors(run.cell.settings.tool),
    }
    try:
        refined = refine_with_surface(fit.fixed_from_moving, **measured)
    except RefusalError as error:
        if error.refusal_code not in HELPED_BY_POINTS:
            raise
        coverage = surface_coverage(fit.fixed_from_moving, **measured)
        text = f"{error.text} What lowers the predicted TRE most: {coverage.advice}."
        fields = error.fields | {"coverage": _coverage_values(coverage)}
        raise RefusalError(error.refusal_code, text, **fields) from None
    coverage = surface_coverage(refined.body_ref_from_image, **measured)
    run.result |= {
        "landmarks": report,
        "tre_before": refined.tre_before,
        "tre": refined.tre_after,
        "target": report["target"],
        "points": len(data.surface),
        "inliers": int(refined.inliers.sum()),
        "surface_rms": refined.rms,
        "offsets": [msgspec.to_builtins(offset) for offset in refined.offsets],
        "coverage": _coverage_values(coverage),
    }
    run.prepared = fit, refined


def _coverage_values(coverage: SurfaceCoverage) -> dict[str, Any]:
    """Return the coverage as values of a result, lengths in m."""
    values: dict[str, Any] = msgspec.to_builtins(coverage)
    return values | {"advice": coverage.advice}


def keep_refined_registration(run: Run) -> None:
    """Put the refined registration in force. The noise is learned from the residuals of the landmarks alone."""
    fit, refined = run.prepared
    noise = learn_noise(run.cell, run.data, fit.distances)
    activate_registration(run, refined.body_ref_from_image, noise=noise, covariance=refined.covariance.ravel().tolist())


def _surface(run: Run) -> Mesh:
    """Return the requested surface, or the configured one.

    A path from a client is one of the client's machine, Windows or not, so that only the base name has a meaning here.
    """
    settings, requested, mesh = run.cell.settings, run.payload.surface, run.cell.surface
    if requested is not None:
        name = PureWindowsPath(requested).name
        if not name:
            raise RefusalError("unknown_surface", f"{requested!r} names no file of a surface.", surface=requested)
        if name != PureWindowsPath(settings.body.surface).name:
            body = msgspec.structs.replace(settings.body, surface=name)
            try:
                mesh = read_surface(msgspec.structs.replace(settings, body=body))
            except ConfigurationError as error:
                raise RefusalError("unknown_surface", error.text, **error.fields) from None
    if mesh is None:
        text = "The body has no surface: set procedure.body.surface, or name one."
        raise RefusalError("unknown_surface", text)
    return mesh


def _report_count(run: Run) -> None:
    run.result["points"] = len(run.data.surface)


def register_refinement_operations(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these checks and steps."""
    registry.payload("surface_points", SurfacePoints)
    registry.payload("surface_name", SurfaceName)
    registry.check(surface_point_there)
    registry.long_check(surface_refines)
    registry.world_step(digitize_surface_points)
    for step in (drop_last_surface_point, drop_surface_points, keep_refined_registration):
        registry.step(step)
