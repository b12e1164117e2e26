"""Points of the skin, and the registration that they refine."""

from __future__ import annotations

from pathlib import PureWindowsPath
from typing import Annotated, Any

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import ConfigurationError, RefusalError
from pcmrs.formats.mesh import Mesh
from pcmrs.registration.coverage import SurfaceCoverage, surface_coverage
from pcmrs.registration.surface import refine_with_surface
from pcmrs.workflows._registering import activate_registration, judge_landmarks
from pcmrs.workflows._touching import touch
from pcmrs.workflows.accuracy import learn_noise
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Point, as_point
from pcmrs.workflows.reference import check_reference
from pcmrs.workflows.surface import read_surface

Run = AnyRun[Cell, PlacementData]

HELPED_BY_POINTS = ("too_few_surface_points", "surface_flat", "tre_not_lowered")
"""Refusals of a refinement after which more points in the right region help."""


class SurfacePoints(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `digitize_surface`.

    Attributes:
        points: Number of points to touch, one after the other.
    """

    points: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1


class SurfaceName(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `refine`.

    Attributes:
        surface: Base name of the surface's file; None for the configured one.
    """

    surface: str | None = None


async def digitize_surface_points(run: Run) -> None:
    """Digitize points of the skin; either all of them are stored or none."""
    count, points = run.payload.points, list[Point]()
    before = len(run.data.surface)
    for number in range(count):
        run.progress(number / count)
        touched = await touch(run, run.cell.pointer.touch_surface(), f"point {before + number + 1} of the skin")
        check_reference(run.cell, run.data.reference, touched.since)
        points.append(as_point(touched.point))
    run.keep(surface=(*run.data.surface, *points))
    _report_count(run)


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
