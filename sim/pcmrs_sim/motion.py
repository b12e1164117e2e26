"""Motion of the patient's head, and of a pointer that a hand pivots, as functions of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import inf, pi, radians, sin

import numpy as np

from pcmrs.errors import DeviceError
from pcmrs.messages import HeadMotion
from pcmrs.spatial import Floats, Transform

STEP_TIME = 0.1
"""Duration of a sudden shift, s."""
UNIT_TOLERANCE = 1e-3
"""Largest deviation of a direction's length from 1."""

TILT = radians(40.0)
"""Largest angle of the shaft from the mean direction while it pivots, rad."""
SPIN = radians(60.0)
"""Largest rotation of the shaft about itself while it pivots, rad."""
TILT_HZ, AZIMUTH_HZ, SPIN_HZ = 0.131, 0.073, 0.187
"""Frequencies of tilt, azimuth and spin, Hz. They have no short common period, so that poses do not repeat."""


def check_motion(motion: HeadMotion) -> None:
    """Check that all directions of a motion have unit length.

    Raises:
        DeviceError: A direction has another length.
    """
    for direction in (motion.breathing_direction, *(burst.direction for burst in motion.bursts)):
        length = float(np.linalg.norm(direction))
        if not abs(length - 1.0) < UNIT_TOLERANCE:
            raise DeviceError(f"The direction {direction} has length {length:.4g}; give a unit vector.", length=length)


def head_offset(motion: HeadMotion, time: float) -> Floats:
    """Return the displacement of the head since the start of a motion, in the tracker frame, m, (3,).

    Args:
        motion: The motion.
        time: Time since its start, s.
    """
    phase = _phase(motion.seed)
    # Minus the value at the start, so that a motion never begins with a jump.
    breath = sin(2 * pi * motion.breathing_hz * time + phase) - sin(phase)
    offset = time * np.array(motion.drift)
    offset += motion.breathing_amplitude * breath * np.array(motion.breathing_direction)
    for step in motion.steps:
        offset += _minimum_jerk((time - step.time) / STEP_TIME) * np.array(step.offset)
    for burst in motion.bursts:
        moving = min(max(time - burst.time, 0.0), burst.duration)
        offset += moving * burst.speed * np.array(burst.direction)
    return offset


@cache
def _phase(seed: int) -> float:
    return float(np.random.default_rng(seed).uniform(0.0, 2 * pi))


def _minimum_jerk(fraction: float) -> float:
    """Return a minimum-jerk motion from 0 to 1 at a fraction of its duration (Flash, Hogan, J. Neuroscience 1985)."""
    x = min(max(fraction, 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


@dataclass(frozen=True, eq=False)
class Pivot:
    """Rotation of the pointer about its tip, which rests in a divot.

    Attributes:
        start: Time of its start, s of the cell.
        end: Time at which the pointer is taken away, s of the cell.
        image_from_tip: Pose of the tip in the divot, with +z along the mean direction of the shaft.
        tip_from_pointer: Pose of the marker body on the shaft.
    """

    start: float
    end: float
    image_from_tip: Transform
    tip_from_pointer: Transform

    def image_from_pointer(self, time: float) -> Transform:
        """Return the pose of the marker body at a time of the cell, s."""
        since = time - self.start
        tilt = TILT * sin(2 * pi * TILT_HZ * since)
        azimuth = 2 * pi * AZIMUTH_HZ * since
        tilted = Transform.from_rotvec(np.zeros(3), tilt * np.array((np.cos(azimuth), np.sin(azimuth), 0.0)))
        spun = Transform.from_rotvec(np.zeros(3), (0.0, 0.0, SPIN * sin(2 * pi * SPIN_HZ * since)))
        return self.image_from_tip @ tilted @ spun @ self.tip_from_pointer


SLIDE_SPACING = 0.004
"""Distance of two poses of a sliding pointer, m."""
SLIDE_SPEED = 0.06
"""Speed at which a hand slides the tip, m/s."""


@dataclass(frozen=True, eq=False)
class Slide:
    """Motion of the pointer whose tip a hand slides over the skin, back and forth.

    Attributes:
        start: Time of its start, s of the cell.
        poses: ``image_from_pointer`` along the way, `SLIDE_SPACING` apart.
    """

    start: float
    poses: Sequence[Transform]

    end = inf
    """The hand stops when the pointer is released."""

    def image_from_pointer(self, time: float) -> Transform:
        """Return the pose of the marker body at a time of the cell, s."""
        last = len(self.poses) - 1
        along = int((time - self.start) * SLIDE_SPEED / SLIDE_SPACING) % (2 * last)
        return self.poses[min(along, 2 * last - along)]
