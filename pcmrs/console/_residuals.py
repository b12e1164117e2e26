"""Quality of the registration: residuals in words, and the predicted error as colours on the surface."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from nicegui import ui

from pcmrs.console._cell_view_model import NOTHING, CellViewModel
from pcmrs.console._geometry import decimate, residuals, vertices_of
from pcmrs.console.texts import Texts
from pcmrs.errors import GeometryError
from pcmrs.messages.setup import ProcedureDataView, Setup, SurfaceShown
from pcmrs.spatial import Floats
from pcmrs.workflows.accuracy import tre_over
from pcmrs.workflows.data import as_transform

STOPS = 9
"""Number of colours in the legend."""


def predicted(data: ProcedureDataView, points: Floats) -> Floats | None:
    """Return the predicted rms error at points in the image, m, (M,); None while nothing is registered.

    Args:
        data: Data of the procedure, with the registration in force.
        points: Points in the image, m, (M, 3).
    """
    if data.body_ref_from_image is None or data.sigma is None:
        return None
    landmarks = np.array([each.planned for each in data.landmarks]).reshape(-1, 3)
    try:
        return tre_over(landmarks, as_transform(data.body_ref_from_image), data.covariance, data.sigma, points)
    except GeometryError:  # the landmarks do not belong to the registration: they are being planned again
        return None


def coloured(surface: SurfaceShown, data: ProcedureDataView, limit: float) -> bytes | None:
    """Return the lighter surface as GLB, with vertices coloured by the predicted error; None as `predicted`.

    Args:
        surface: Surface of the body.
        data: Data of the procedure, with the registration in force.
        limit: Error of the last colour, m.
    """
    vertices, faces = vertices_of(decimate(surface))
    errors = predicted(data, vertices)
    if errors is None:
        return None
    from trimesh import Scene, Trimesh  # takes long to load
    from trimesh.exchange.gltf import export_glb

    mesh = Trimesh(vertices, faces, process=False, vertex_colors=_linear(colours(errors / limit)))
    export: Callable[..., bytes] = export_glb
    return export(Scene(mesh), include_normals=True, tree_postprocessor=_make_matte)


def colours(shares: Floats) -> Floats:
    """Return colours of Cividis, which looks the same to everybody: sRGB of shares from 0 to 1, (M, 3)."""
    found: Floats = np.asarray(_cividis()(np.clip(shares, 0.0, 1.0)))[:, :3]
    return found


def gradient() -> str:
    """Return the legend, left to right, as CSS."""
    stops = (f"rgb({r:.0f}, {g:.0f}, {b:.0f})" for r, g, b in 255.0 * colours(np.linspace(0.0, 1.0, STOPS)))
    return f"linear-gradient(to right, {', '.join(stops)})"


@cache
def _cividis() -> Any:
    from matplotlib import colormaps  # takes long to load

    return colormaps["cividis"]


def _linear(srgb: Floats) -> Any:
    """Return colours as GLB has them: linear, 8 bits, opaque, (M, 4). IEC 61966-2-1."""
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return np.column_stack((np.round(255.0 * linear), np.full(len(srgb), 255.0))).astype(np.uint8)


def _make_matte(tree: dict[str, Any]) -> None:
    """Set a material without reflection: by default the format means metal, which looks black."""
    tree["materials"] = [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}]
    for primitive in (each for mesh in tree["meshes"] for each in mesh["primitives"]):
        primitive["material"] = 0


class ResidualsView:
    """A line and one chip for each landmark; nothing while nothing is registered.

    Args:
        view: State of the cell to show.
        setup: Setup of the cell.
        texts: Texts in the language of the page.
    """

    def __init__(self, view: CellViewModel, setup: Setup, texts: Texts) -> None:
        self._view, self._limit, self._texts = view, setup.residual_limit, texts
        self._drawn = NOTHING
        with ui.column().classes("gap-1") as self._whole:
            self._mean = ui.label().props('data-testid="residual"')
            self._each = ui.row().classes("gap-1").props('data-testid="landmark-residuals"')
        self._whole.set_visibility(False)

    def refresh(self) -> None:
        """Show the present residuals."""
        data = self._view.data
        if data == self._drawn:
            return
        self._drawn = data
        self._whole.set_visibility(data.residual is not None)
        self._mean.set_text(mean_in_words(data, self._limit, self._texts))
        self._each.clear()
        with self._each:
            for words, is_good in each_in_words(data, self._limit, self._texts):
                ui.badge(words, color="green-9" if is_good else "deep-orange-10").classes("text-body2")


def mean_in_words(data: ProcedureDataView, limit: float, texts: Texts) -> str:
    """Return the mean of all residuals against its limit; empty while nothing is registered.

    Args:
        data: Data of the procedure.
        limit: Limit of the mean, m.
        texts: Texts in the language of the page.
    """
    if data.residual is None:
        return ""
    return texts("residual", mm=1000.0 * data.residual, limit=1000.0 * limit)


def each_in_words(data: ProcedureDataView, limit: float, texts: Texts) -> list[tuple[str, bool]]:
    """Return each landmark that has a residual, in the order of the plan, and whether it is within the limit.

    Args:
        data: Data of the procedure.
        limit: Limit of the mean, m.
        texts: Texts in the language of the page.
    """
    return [
        (
            texts(
                "landmark_within" if residual <= limit else "landmark_beyond",
                name=landmark.name,
                mm=1000.0 * residual,
                limit=1000.0 * limit,
            ),
            residual <= limit,
        )
        for landmark, residual in zip(data.landmarks, residuals(data), strict=True)
        if residual is not None
    ]
