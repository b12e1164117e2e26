"""Points and motions at random."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pcmrs.spatial import Transform

seeds = st.integers(0, 2**32 - 1)
SQUARE = 0.1 * np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)


def random_motion(rng: np.random.Generator) -> Transform:
    return Transform(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))


def random_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points in a box of unequal sides about corners that make them span a triangle."""
    corners = np.array([(0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)])
    return np.concatenate((corners, rng.uniform(-0.1, 0.1, (count - 3, 3)))) + rng.normal(size=3)
