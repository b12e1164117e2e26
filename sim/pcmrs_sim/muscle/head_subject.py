"""The subject on the head phantom, drawn from the published population."""

from __future__ import annotations

from functools import cache

import numpy as np

from pcmrs.spatial import Floats, Transform
from pcmrs.tms.scalp import hand_area
from pcmrs_sim.head import CENTRE, EXPONENT, SEMI_AXES, surface_point
from pcmrs_sim.tms.subject import Subject, draw

STREAM = 2002
"""Number of the random stream of the subject, so that it is independent of the other streams of a seed."""
ITERATIONS = 20
"""Iterations of the search for the nearest point. Near the scalp, each at least halves the error."""


def draw_subject(phantom: str, seed: int) -> Subject | None:
    """Draw a subject; return None if the phantom is not the head.

    Args:
        phantom: Name of the phantom, as in the setting ``sim.phantom``.
        seed: Seed of the subject.
    """
    if phantom != "head":
        return None
    return draw(closest_on_scalp, _centre(), np.random.default_rng((seed, STREAM)))


@cache
def _centre() -> Transform:
    """Return the usual pose over the hand area of the head, which all subjects share."""
    return hand_area(closest_on_scalp, surface_point((0.0, 0.0, 1.0)))


def closest_on_scalp(points: Floats) -> tuple[Floats, Floats]:
    """Return the nearest points of the head's surface, m, (K, 3), and the outward unit normals there, (K, 3).

    The foot of the perpendicular is found by fixed-point iteration: move along the normal at the last foot, then onto
    the surface.

    Args:
        points: Points near the scalp, in the image, m, (K, 3).
    """
    feet = _onto_surface(points)
    for _ in range(ITERATIONS):
        normals = _normals(feet)
        heights = np.sum((points - feet) * normals, axis=1, keepdims=True)
        feet = _onto_surface(points - heights * normals)
    return feet, _normals(feet)


def _onto_surface(points: Floats) -> Floats:
    """Move points along rays from the centre of the head onto its surface, m, (K, 3)."""
    rays = points - CENTRE
    scales = np.sum(np.abs(rays / SEMI_AXES) ** EXPONENT, axis=1, keepdims=True) ** (-1.0 / EXPONENT)
    feet: Floats = CENTRE + scales * rays
    return feet


def _normals(feet: Floats) -> Floats:
    """Return the outward unit normals at points of the surface, (K, 3): the gradient of its implicit function."""
    offsets = (feet - CENTRE) / SEMI_AXES
    gradients = np.sign(offsets) * np.abs(offsets) ** (EXPONENT - 1.0) / SEMI_AXES
    normals: Floats = gradients / np.linalg.norm(gradients, axis=1, keepdims=True)
    return normals
