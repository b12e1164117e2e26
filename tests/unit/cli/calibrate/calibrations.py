"""Poses of a pivoted pointer and of a tool on an arm, and `pcmrs calibrate` on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from click.testing import CliRunner, Result
from scipy.spatial.transform import Rotation

from pcmrs.calibration.poses import PIVOT, write_poses
from pcmrs.cli import main
from pcmrs.spatial import Transform

TIP, PIVOT_POINT = np.array([0.01, -0.02, -0.15]), np.array([0.1, 0.2, 1.8])
FLANGE_FROM_TOOL_MARKER = Transform.from_rotvec((0.01, 0.02, 0.15), (2.0, 1.0, 0.5))
BASE_FROM_TRACKER = Transform.from_rotvec((1.5, 0.3, 0.9), (0.4, -2.0, 1.0))
JITTER = 3e-5
HOME = np.array([0.0, 0.6, 0.0, -1.4, 0.0, 1.0, 0.0])


def run(*words: str) -> Result:
    return CliRunner().invoke(main, ["calibrate", *words])


def pivoted(rng: np.random.Generator, tilt: tuple[float, float], spin: float = 0.0) -> Transform:
    """The pointer tilted (rad) about its tip."""
    rotation = Rotation.from_euler("xyz", (*tilt, spin)).as_matrix()
    return Transform(rotation, PIVOT_POINT - rotation @ TIP + rng.normal(0.0, JITTER, 3))


def pivot_file(folder: Path, *, tilt: float = 0.6, bad: tuple[int, ...] = ()) -> str:
    rng = np.random.default_rng(1)
    poses = [pivoted(rng, tuple(rng.uniform(-tilt, tilt, 2)), rng.uniform(-0.6, 0.6)) for _ in range(30)]
    lift = Transform.from_rotvec((0.0, 0.0, 0.004), (0.0, 0.0, 0.0))
    write_poses(folder / "pivot.csv", PIVOT, [[lift @ p if i in bad else p for i, p in enumerate(poses)]])
    return str(folder / "pivot.csv")


def coil_seen(flange: Transform) -> Transform:
    return BASE_FROM_TRACKER.inverse() @ flange @ FLANGE_FROM_TOOL_MARKER
