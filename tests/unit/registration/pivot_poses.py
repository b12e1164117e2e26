"""Poses of a pointer whose tip rests at one place."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pcmrs.spatial import Floats, Transform

TIP = np.array([0.01, -0.02, -0.15])
PIVOT = np.array([0.1, 0.2, -1.8])
NOISE = 1e-4


def poses_about(
    rng: np.random.Generator,
    count: int,
    noise: float = 0.0,
    tilt: float = 40.0,
    tip: Floats = TIP,
    pivot: Floats = PIVOT,
) -> list[Transform]:
    """Poses of a pointer whose tip rests on the pivot, with noise of the position (m per axis)."""
    rotations = Rotation.from_euler("xyz", rng.uniform(-tilt, tilt, (count, 3)), degrees=True).as_matrix()
    return [Transform(rotation, pivot - rotation @ tip + rng.normal(0.0, noise, 3)) for rotation in rotations]


def shifted(poses: list[Transform], bad: list[int], by: float) -> list[Transform]:
    """Some of the poses with the tip lifted by so much (m)."""
    lift = np.array([0.0, 0.0, by])
    return [
        Transform(pose.rotation, pose.translation + lift) if index in bad else pose for index, pose in enumerate(poses)
    ]
