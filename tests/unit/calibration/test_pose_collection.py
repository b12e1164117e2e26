"""Which poses are kept, and when they suffice."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.calibration.pose_collection import PoseCollection
from pcmrs.spatial import Transform

STEP, SPREAD = np.radians(2.0), np.radians(15.0)


def turned(x: float, y: float) -> Transform:
    """Turned about x, then y, °."""
    about_x = Transform.from_rotvec((0.0,) * 3, (np.radians(x), 0.0, 0.0))
    return Transform.from_rotvec((0.0,) * 3, (0.0, np.radians(y), 0.0)) @ about_x


def collect(poses: list[Transform]) -> PoseCollection:
    collection = PoseCollection(count=8, spread=SPREAD, step=STEP)
    for pose in poses:
        if collection.is_new(pose):
            collection.poses.append(pose)
    return collection


def test_a_pointer_that_rests_gives_one_pose() -> None:
    collection = collect([turned(0.5 * index % 1.5, 0.0) for index in range(100)])
    assert len(collection.poses) == 1
    assert collection.progress == 0.0


def test_turning_about_one_axis_is_never_enough() -> None:
    collection = collect([turned(float(angle), 0.0) for angle in range(-60, 60)])
    assert len(collection.poses) > 8
    assert collection.progress == pytest.approx(0.0, abs=1e-6)


def test_enough_poses_turned_about_two_axes_are_enough() -> None:
    circle = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    collection = collect([turned(30 * np.cos(angle), 30 * np.sin(angle)) for angle in circle])
    assert collection.progress == 1.0
    assert "12 of 8 poses" in str(collection)
    few = collect([turned(30 * np.cos(angle), 30 * np.sin(angle)) for angle in circle[::3]])
    assert few.progress == pytest.approx(0.5)
