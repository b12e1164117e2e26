"""An arm at a spring: a follower, and a sensor without delay, for tests of motion."""

import numpy as np
import pytest

from pcmrs.devices.motion.follower import Follower, brake_limits
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats

MODEL = ArmModel(ARMS["iiwa14"])

HOME = np.array(ARMS["iiwa14"].home)

ACCELERATION, JERK = 10.0, 200.0

LIMITS = brake_limits(MODEL.facts, ACCELERATION, JERK)

STEPS = pytest.mark.parametrize("step", [1 / 1000, 1 / 200])


class Spring:
    """The tool at a spring that begins `gap` m before it, seen without delay."""

    axis = np.array((0.0, 0.0, -1.0))

    def __init__(self, gap: float, stiffness: float = 1000.0) -> None:
        self._gap, self._stiffness = gap, stiffness
        self.magnitude = 0.0
        self._start = MODEL.forward(HOME)

    def move_to(self, gap: float, posture: Floats) -> None:
        """The body has moved: it begins `gap` m before where the tool was at first; the tool is at `posture`."""
        self._gap = gap
        self.look(posture)

    def look(self, posture: Floats) -> None:
        way = self._start.inverse() @ MODEL.forward(posture).translation
        self.magnitude = max(0.0, float(way[2]) - self._gap) * self._stiffness

    @property
    def flange_force(self) -> tuple[float, float, float]:
        return (0.0, 0.0, -self.magnitude)


def follower(step: float, sensor: Spring | None = None, posture: Floats = HOME, **force: float) -> Follower:
    return Follower(MODEL, LIMITS, ForceSettings(**force), sensor or Spring(1.0), posture, step)


def run(arm: Follower, sensor: Spring, step: float, seconds: float) -> Floats:
    """Samples until the arm stands, (N, 3, n)."""
    samples = []
    for _ in range(round(seconds / step)):
        samples.append(arm.advance().copy())
        sensor.look(samples[-1][0])
        if arm.reference.ended:
            break
    return np.array(samples)
