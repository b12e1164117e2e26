"""Landmark layouts of the tests, in m, and noise that reproduces the published controls."""

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from pcmrs.spatial import Floats, Transform

HEAD_NAMES = ("nasion", "nose_tip", "left_outer_canthus", "right_outer_canthus", "left_tragus", "right_tragus")
HEAD = np.array(
    [
        (0.004, 0.086, 0.040),
        (0.004, 0.104, -0.008),
        (-0.046, 0.069, 0.035),
        (0.054, 0.069, 0.035),
        (-0.079, -0.008, 0.019),
        (0.087, -0.008, 0.019),
    ]
)
VERTEX = np.array([0.004, -0.012, 0.143])
HEAD_SIGMA = 1.86e-3

FEMUR_NAMES = ("greater_trochanter", "lesser_trochanter", "femoral_head", "lateral_shaft")
FEMUR = np.array([(0.117, -0.004, 0.010), (0.062, -0.009, -0.058), (0.021, 0.027, 0.023), (0.098, 0.017, -0.140)])
FEMUR_SIGMA = 1.03e-3


def any_motion(rng: np.random.Generator) -> Transform:
    return Transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.5, 0.5, 3))


def touched(rng: np.random.Generator, planned: Floats, sigma: float) -> Floats:
    """The landmarks as touched, in body_ref."""
    moved: Floats = any_motion(rng) @ (planned + rng.normal(scale=sigma, size=planned.shape))
    return moved


def off_by_10_mm(rng: np.random.Generator, runs: int) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Digitized heads (runs, 6, 3) with one landmark off in any direction, and which one."""
    digitized, index = HEAD + rng.normal(scale=HEAD_SIGMA, size=(runs, 6, 3)), rng.integers(6, size=runs)
    directions = rng.normal(size=(runs, 3))
    digitized[np.arange(runs), index] += 0.010 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return digitized, index
