"""The paper's picture of placements: errors per trial, and the error vectors where the targets are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pcmrs.analysis.placements import PlacementError, Recorded
from pcmrs.analysis.plots import BLUE, ORANGE, new_figure
from pcmrs.spatial import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ARROW_SHARE = 0.25
"""Length of the longest arrow against the extent of the targets."""

SMALLEST_EXTENT_MM = 10.0
"""Of targets that are one and the same."""


def placement_figure(recorded: Sequence[Recorded], title: str) -> Figure:
    """Two panels of one or more placements: both errors of each trial; error vectors at the targets, in the image."""
    figure = new_figure()
    figure.suptitle(title)
    errors = [item.error for item in recorded]
    _draw_errors(figure.add_subplot(1, 2, 1), errors)
    targets = np.array([item.placement.planned.translation for item in recorded])
    rotations = [item.placement.measured.rotation for item in recorded]
    vectors = np.array([rotation @ error.vector for rotation, error in zip(rotations, errors, strict=True)])
    _draw_vectors(figure.add_subplot(1, 2, 2, projection="3d"), targets * 1000.0, vectors * 1000.0)
    return figure


def _draw_errors(axes: Any, errors: Sequence[PlacementError]) -> None:
    trials = np.arange(1, len(errors) + 1)
    distances_mm = np.array([error.distance for error in errors]) * 1000.0
    angles_deg = np.degrees([error.angle for error in errors])
    axes.bar(trials, distances_mm, color=BLUE)
    axes.axhline(distances_mm.mean(), color=BLUE, linestyle="--")
    axes.set_xlabel("trial")
    axes.set_ylabel("translation error, mm", color=BLUE)
    axes.xaxis.get_major_locator().set_params(integer=True)
    turned = axes.twinx()
    turned.plot(trials, angles_deg, "D", color=ORANGE)
    turned.axhline(angles_deg.mean(), color=ORANGE, linestyle=":")
    turned.set_ylim(bottom=0.0)
    turned.set_ylabel("rotation error, ° (lines: means)", color=ORANGE)


def _draw_vectors(axes: Any, targets_mm: Floats, vectors_mm: Floats) -> None:
    extent = max(float(np.ptp(targets_mm, axis=0).max()), SMALLEST_EXTENT_MM)
    longest = float(np.linalg.norm(vectors_mm, axis=1).max())
    scale = ARROW_SHARE * extent / longest if longest > 0.0 else 1.0
    axes.scatter(*targets_mm.T, color=BLUE, label="target")
    axes.quiver(*targets_mm.T, *(scale * vectors_mm).T, color=ORANGE, label=f"error, {scale:.3g} times its length")
    middle = (targets_mm.min(axis=0) + targets_mm.max(axis=0)) / 2.0
    half = (0.5 + ARROW_SHARE) * extent
    for name, center in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{name}lim")(center - half, center + half)
        getattr(axes, f"set_{name}label")(f"{name}, mm")
    axes.locator_params(nbins=5)
    axes.set_box_aspect(None, zoom=0.85)  # or the outermost label is cut off
    axes.legend(loc="upper left")
