"""Who lies under the coil: a subject of the published population on the head phantom."""

from __future__ import annotations

from functools import cache

import numpy as np

from pcmrs.spatial import Floats, Transform
from pcmrs.tms.scalp import hand_area
from pcmrs_sim.head import CENTRE, EXPONENT, SEMI_AXES, surface_point
from pcmrs_sim.tms.subject import Subject, draw

STREAM = 2002
"""Keeps these draws apart from all others of a seed."""
ROUNDS = 20
"""Of the search for the nearest point; each brings a point near the scalp at least twice as near."""


def draw_subject(phantom: str, seed: int) -> Subject | None:
    """The subject of a seed; None where the phantom is no head."""
    if phantom != "head":
        return None
    return draw(closest_on_scalp, _centre(), np.random.default_rng((seed, STREAM)))


@cache
def _centre() -> Transform:
    """Over the hand area of the head, the same for all subjects."""
    return hand_area(closest_on_scalp, surface_point((0.0, 0.0, 1.0)))


def closest_on_scalp(points: Floats) -> tuple[Floats, Floats]:
    """Nearest points of the head's surface, m, (K, 3), and the outward unit normals there, (K, 3).

    The foot of the perpendicular by fixed-point iteration: along the normal at the last foot, then onto the surface.

    Args:
        points: Near the scalp, m, (K, 3).
    """
    feet = _onto_surface(points)
    for _ in range(ROUNDS):
        normals = _normals(feet)
        heights = np.sum((points - feet) * normals, axis=1, keepdims=True)
        feet = _onto_surface(points - heights * normals)
    return feet, _normals(feet)


def _onto_surface(points: Floats) -> Floats:
    """Along the rays from the centre of the head."""
    rays = points - CENTRE
    scales = np.sum(np.abs(rays / SEMI_AXES) ** EXPONENT, axis=1, keepdims=True) ** (-1.0 / EXPONENT)
    onto: Floats = CENTRE + scales * rays
    return onto


def _normals(feet: Floats) -> Floats:
    offsets = (feet - CENTRE) / SEMI_AXES
    gradients = np.sign(offsets) * np.abs(offsets) ** (EXPONENT - 1.0) / SEMI_AXES
    normals: Floats = gradients / np.linalg.norm(gradients, axis=1, keepdims=True)
    return normals
