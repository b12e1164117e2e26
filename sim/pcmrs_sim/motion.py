"""How the patient's head moves, and how a hand pivots the pointer: functions of time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import pi, radians, sin

import numpy as np

from pcmrs.errors import DeviceError
from pcmrs.messages import HeadMotion
from pcmrs.spatial import Floats, Transform

STEP_TIME = 0.1
"""Time that a sudden shift takes, s."""
UNIT_TOLERANCE = 1e-3

TILT = radians(40.0)
"""The shaft's greatest angle to the middle direction of a pivoting."""
SPIN = radians(60.0)
"""And its greatest turn about itself."""
TILT_HZ, AZIMUTH_HZ, SPIN_HZ = 0.131, 0.073, 0.187  # no common period: no pose comes twice


def check_motion(motion: HeadMotion) -> None:
    """Accepts directions of unit length.

    Raises:
        DeviceError: One has another.
    """
    for direction in (motion.breathing_direction, *(burst.direction for burst in motion.bursts)):
        length = float(np.linalg.norm(direction))
        if not abs(length - 1.0) < UNIT_TOLERANCE:
            raise DeviceError(f"The direction {direction} has length {length:.4g}; give a unit vector.", length=length)


def head_offset(motion: HeadMotion, time: float) -> Floats:
    """Where the head is, `time` s after the motion began, from where it was then, in the tracker's axes, m, (3,)."""
    phase = _phase(motion.seed)
    breath = sin(2 * pi * motion.breathing_hz * time + phase) - sin(phase)
    offset = time * np.array(motion.drift)
    offset += motion.breathing_amplitude * breath * np.array(motion.breathing_direction)
    for step in motion.steps:
        offset += _smooth((time - step.time) / STEP_TIME) * np.array(step.offset)
    for burst in motion.bursts:
        moving = min(max(time - burst.time, 0.0), burst.duration)
        offset += moving * burst.speed * np.array(burst.direction)
    return offset


@cache
def _phase(seed: int) -> float:
    return float(np.random.default_rng(seed).uniform(0.0, 2 * pi))


def _smooth(part: float) -> float:
    """From 0 to 1 with minimum jerk (Flash, Hogan, J. Neuroscience 1985)."""
    x = min(max(part, 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


@dataclass(frozen=True, eq=False)
class Pivot:
    """The pointer turns about its tip, which rests in a divot.

    Attributes:
        start: When it begins, s.
        end: When the pointer goes away, s.
        image_from_tip: The tip in the divot, with the shaft's middle direction along +z.
        tip_from_pointer: The marker body on the shaft.
    """

    start: float
    end: float
    image_from_tip: Transform
    tip_from_pointer: Transform

    def image_from_pointer(self, time: float) -> Transform:
        """Where the marker body is at a time, s."""
        since = time - self.start
        tilt = TILT * sin(2 * pi * TILT_HZ * since)
        azimuth = 2 * pi * AZIMUTH_HZ * since
        tilted = Transform.from_rotvec(np.zeros(3), tilt * np.array((np.cos(azimuth), np.sin(azimuth), 0.0)))
        spun = Transform.from_rotvec(np.zeros(3), (0.0, 0.0, SPIN * sin(2 * pi * SPIN_HZ * since)))
        return self.image_from_tip @ tilted @ spun @ self.tip_from_pointer
