"""The picture of `pcmrs register`."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pcmrs.formats.landmarks import Pairs
from pcmrs.spatial import Floats, Transform

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ENLARGED = 10
"""Magnification of the residuals, which are a hundredth of a head and would be invisible."""
PLANNED, MEASURED = "#0072B2", "#D55E00"
"""Blue and vermilion of M. Okabe, K. Ito, Color Universal Design, 2008."""


def draw(pairs: Pairs, body_ref_from_image: Transform, limit: float, heading: str, path: Path) -> None:
    """Draw residuals as vectors on the planned landmarks in the image, and as bars beside the limit of their mean.

    Args:
        pairs: The landmarks.
        body_ref_from_image: The registration.
        limit: Limit of the mean residual, m.
        heading: Text of the verdict.
        path: PNG file to write.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 5.5), layout="constrained")
    figure.suptitle("\n".join(textwrap.wrap(f"Registration {heading}", 110)))
    residuals = body_ref_from_image.inverse() @ pairs.digitized - pairs.planned
    places = figure.add_gridspec(1, 2, wspace=0.25)  # the layout ignores the labels of three-dimensional axes
    _draw_vectors(figure.add_subplot(places[0], projection="3d"), pairs, residuals)
    _draw_bars(figure.add_subplot(places[1]), pairs, residuals, limit)
    figure.savefig(path, format="png", dpi=120)


def _draw_vectors(axes: Any, pairs: Pairs, residuals: Floats) -> None:  # axes of mplot3d have no types
    planned_mm, residuals_mm = pairs.planned * 1000.0, residuals * 1000.0
    axes.scatter(*planned_mm.T, color=PLANNED)
    axes.quiver(*planned_mm.T, *(ENLARGED * residuals_mm).T, color=MEASURED)
    for name, place in zip(pairs.names, planned_mm, strict=True):
        axes.text(*place, f" {name}", fontsize=8)
    axes.set(xlabel="right, mm", ylabel="anterior, mm", zlabel="superior, mm")
    axes.set_title(f"digitized − planned, in the image, enlarged {ENLARGED} times")
    axes.set_aspect("equal")


def _draw_bars(axes: Axes, pairs: Pairs, residuals: Floats, limit: float) -> None:
    distances_mm = np.linalg.norm(residuals, axis=1) * 1000.0
    axes.barh(pairs.names, distances_mm, color=MEASURED)
    axes.axvline(float(distances_mm.mean()), color=PLANNED, label=f"mean {distances_mm.mean():.2f} mm")
    axes.axvline(limit * 1000.0, color="black", linestyle="--", label=f"limit of the mean {limit * 1000:.2f} mm")
    axes.invert_yaxis()
    axes.set(xlabel="residual, mm", title="residual of each landmark")
    axes.legend()
