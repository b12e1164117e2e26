"""Which poses of a moving pointer or arm are worth keeping, and when there are enough of them."""

from __future__ import annotations

import numpy as np

from pcmrs.registration.pose_sets import turning
from pcmrs.spatial import Transform, rotation_angle


class Gathering:
    """Poses that differ from one another, until they turn enough.

    Args:
        count: So many are wanted at least.
        spread: Least rms rotation about the axis they turn about least, rad; see `turning`.
        step: A pose turned by less than this from every one that was taken says nothing new, rad.
    """

    def __init__(self, count: int, spread: float, step: float) -> None:
        self.poses: list[Transform] = []
        self._count = count
        self._wanted = spread
        self._step = step

    @property
    def spread(self) -> float:
        """Rms rotation about the axis the poses turn about least, rad."""
        rotations = [pose.rotation for pose in self.poses]
        return float(np.arcsin(min(1.0, turning(rotations).singular_values[2]))) if len(rotations) > 1 else 0.0

    @property
    def progress(self) -> float:
        """From 0 to 1: enough poses, and turned enough."""
        return min(1.0, len(self.poses) / self._count, self.spread / self._wanted)

    def is_new(self, pose: Transform) -> bool:
        """Whether the pose says something new."""
        return all(rotation_angle(pose, known) >= self._step for known in self.poses)

    def __str__(self) -> str:
        turned, wanted = np.degrees(self.spread), np.degrees(self._wanted)
        return f"{len(self.poses)} of {self._count} poses, turned {turned:.0f}° of {wanted:.0f}° about every axis"
