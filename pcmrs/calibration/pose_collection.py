"""Collection of calibration poses: which poses of a moving pointer or arm to keep, and when there are enough."""

from __future__ import annotations

import numpy as np

from pcmrs.registration.pose_sets import rotation_spread
from pcmrs.spatial import Transform, rotation_angle


class PoseCollection:
    """Poses that differ from each other, collected until their rotations vary enough.

    Args:
        count: Least number of poses.
        spread: Least rms rotation about the axis about which the poses turn least, rad; see `rotation_spread`.
        step: Least rotation of a new pose from each of the collected ones, rad.

    Attributes:
        poses: Collected poses.
    """

    def __init__(self, count: int, spread: float, step: float) -> None:
        self.poses: list[Transform] = []
        self._count = count
        self._required_spread = spread
        self._step = step

    @property
    def spread(self) -> float:
        """Rms rotation about the axis about which the poses turn least, rad."""
        rotations = [pose.rotation for pose in self.poses]
        return float(np.arcsin(min(1.0, rotation_spread(rotations).singular_values[2]))) if len(rotations) > 1 else 0.0

    @property
    def progress(self) -> float:
        """Progress from 0 to 1, which is reached when there are enough poses and they turn enough."""
        return min(1.0, len(self.poses) / self._count, self.spread / self._required_spread)

    def is_new(self, pose: Transform) -> bool:
        """Return True if the pose is turned far enough from every collected one."""
        return all(rotation_angle(pose, stored) >= self._step for stored in self.poses)

    def __str__(self) -> str:
        turned, required = np.degrees(self.spread), np.degrees(self._required_spread)
        return f"{len(self.poses)} of {self._count} poses, turned {turned:.0f}° of {required:.0f}° about every axis"
