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
        if _on_head(direction):
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


PATH_STEPS = 400
"""Number of points of a path over the surface."""
PATH_ANGLE = 0.04
"""Angle between two directions of a path, rad: some 4 mm of the skin."""


def surface_path(phantom: str, rng: np.random.Generator) -> Floats:
    """Draw a path over a phantom's surface that a tip can follow, in the image, m, (N, 3).

    Args:
        phantom: Value of the setting ``sim.phantom``.
        rng: Source of random numbers.
    """
    if phantom == "head":
        return np.array([head.surface_point(each) for each in _wandering(rng, _on_head)])
    part = femur.BONE[0]
    directions = _wandering(rng, lambda _: True)
    along = np.linspace(0.2, 0.8, len(directions))[:, None]
    inside = part.start + along * (part.end - part.start)
    return np.array([femur.surface_point(*each) for each in zip(inside, directions, strict=True)])


def _on_head(direction: Floats) -> bool:
    return bool(direction[2] > LOWEST_ON_TOP or direction[1] > LOWEST_ON_FACE)


def _wandering(rng: np.random.Generator, allowed: Callable[[Floats], bool]) -> list[Floats]:
    """Return directions, each a small angle from the one before, that turn at random where the next is not allowed."""
    direction = _random_direction(rng)
    while not allowed(direction):
        direction = _random_direction(rng)
    found, heading = [direction], _across(_random_direction(rng), direction)
    while len(found) < PATH_STEPS:
        heading = _across(heading + 0.2 * rng.normal(size=3), direction)
        further = np.cos(PATH_ANGLE) * direction + np.sin(PATH_ANGLE) * heading
        if allowed(further):
            found.append(further)
            direction = further
        else:
            heading = _across(_random_direction(rng), direction)
    return found


def _across(vector: Floats, direction: Floats) -> Floats:
    """Return the unit vector of the part of a vector that is perpendicular to a unit vector."""
    across: Floats = vector - (vector @ direction) * direction
    return across / np.linalg.norm(across)


def _random_direction(rng: np.random.Generator) -> Floats:
    vector: Floats = rng.normal(size=3)
    return vector / np.linalg.norm(vector)
