"""Where a person who may touch any point of the skin, or of the bone, puts the pointer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pcmrs.spatial import Floats
from pcmrs_sim import femur, head

LOWEST_ON_TOP = 0.2
LEAST_ON_FACE = 0.5
"""Parts of a direction upwards, and to the front: neck and cushion are behind and below."""


def touch_head(rng: np.random.Generator) -> Floats:
    """A point of the top of the head or of the face, in the image, m, (3,)."""
    while True:
        direction = _direction(rng)
        if direction[2] > LOWEST_ON_TOP or direction[1] > LEAST_ON_FACE:
            return head.surface_point(direction)


def touch_femur(rng: np.random.Generator) -> Floats:
    """A point of the bone, seen from anywhere in it, in the image, m, (3,)."""
    part = femur.BONE[rng.integers(len(femur.BONE))]
    inside = part.start + rng.uniform() * (part.end - part.start)
    return femur.surface_point(inside, _direction(rng))


TOUCHES: dict[str, Callable[[np.random.Generator], Floats]] = {"head": touch_head, "femur": touch_femur}
"""By phantom."""


def _direction(rng: np.random.Generator) -> Floats:
    vector: Floats = rng.normal(size=3)
    return vector / np.linalg.norm(vector)
