"""The phantoms of the setting ``sim.phantom``, and random points of their surfaces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pcmrs.spatial import Floats
from pcmrs_sim import femur, head
from pcmrs_sim.femur import FEMUR
from pcmrs_sim.head import HEAD

PHANTOMS = {"head": HEAD, "femur": FEMUR}
"""Value of the setting to phantom."""

LOWEST_ON_TOP = 0.2
LOWEST_ON_FACE = 0.5
"""Smallest component of a unit vector upwards, on the top of the head, and to the front, on the face. Neck and cushion
cover the rest."""


def head_surface_point(rng: np.random.Generator) -> Floats:
    """Draw a point of the top of the head or of the face, in the image, m, (3,)."""
    while True:
        direction = _random_direction(rng)
        if direction[2] > LOWEST_ON_TOP or direction[1] > LOWEST_ON_FACE:
            return head.surface_point(direction)


def femur_surface_point(rng: np.random.Generator) -> Floats:
    """Draw a point of the bone, in a random direction from a random point of an axis in it, in the image, m, (3,)."""
    part = femur.BONE[rng.integers(len(femur.BONE))]
    inside = part.start + rng.uniform() * (part.end - part.start)
    return femur.surface_point(inside, _random_direction(rng))


SURFACE_POINTS: dict[str, Callable[[np.random.Generator], Floats]] = {
    "head": head_surface_point,
    "femur": femur_surface_point,
}
"""Value of the setting to the function that draws a point of the phantom's surface that a person can touch."""


def _random_direction(rng: np.random.Generator) -> Floats:
    vector: Floats = rng.normal(size=3)
    return vector / np.linalg.norm(vector)
