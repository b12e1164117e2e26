"""References of an arm: their protocol, and a joint trajectory sampled at the arm's rate."""

from __future__ import annotations

from typing import Protocol, Self

import numpy as np

from pcmrs.kinematics.time_parameterization import CubicSpline
from pcmrs.messages import DeviceEvent, JointTrajectory
from pcmrs.spatial import Floats


class SetPoint(Protocol):
    """A moving set point that an arm follows.

    Attributes:
        halt: Reason why the arm must brake now; None if it need not.
        alarm: Event to report when the arm is held; None for no event.
        ended: True if the set point stands still for good.
        position: Present set posture, rad, (n,).
        velocity: Present set velocity, rad/s, (n,).
    """

    @property
    def halt(self) -> str | None: ...

    @property
    def alarm(self) -> DeviceEvent | None: ...

    @property
    def ended(self) -> bool: ...

    @property
    def position(self) -> Floats: ...

    @property
    def velocity(self) -> Floats: ...

    def advance(self) -> Floats:
        """Return the next sample: position, velocity and acceleration, (3, n)."""


class Reference:
    """A set point along stored samples that stays at the last one.

    Args:
        samples: Position rad, velocity rad/s and acceleration rad/s^2 of n joints at every step, (N, 3, n).
    """

    halt: str | None = None
    alarm: DeviceEvent | None = None

    def __init__(self, samples: Floats) -> None:
        self._samples = samples
        self._last = len(samples) - 1
        self._index = 0

    @classmethod
    def standing(cls, posture: Floats) -> Self:
        """Return a set point that does not move, at a posture (n,) in rad."""
        return cls(np.stack((posture, np.zeros_like(posture), np.zeros_like(posture)))[None])

    @classmethod
    def along(cls, trajectory: JointTrajectory, present: SetPoint, step: float) -> Self:
        """Return a set point along a trajectory: a cubic spline from the present set point, clamped to end at rest.

        The trajectory starts near the present set point, not exactly at it; the difference fades out linearly. A
        trajectory of a single posture is no motion.

        Args:
            trajectory: Trajectory to follow.
            present: Set point that is followed now.
            step: Time between samples, s.
        """
        if len(trajectory.positions) == 1:
            return cls.standing(present.position)
        positions = np.array(trajectory.positions)
        positions += np.linspace(present.position - positions[0], 0.0, len(positions))
        times = np.arange(len(positions)) * trajectory.period
        spline = CubicSpline(times, positions, (present.velocity, np.zeros_like(present.velocity)))
        grid = np.linspace(0.0, times[-1], 1 + int(np.ceil(times[-1] / step)))
        samples = np.stack([spline(grid, order) for order in range(3)], axis=1)
        samples[-1, 2] = 0.0  # it stays there
        return cls(samples)

    def advance(self) -> Floats:
        """Return the next sample: position, velocity and acceleration, (3, n)."""
        self._index = min(self._index + 1, self._last)
        sample: Floats = self._samples[self._index]
        return sample

    @property
    def ended(self) -> bool:
        """True if the last sample has been reached."""
        return self._index == self._last

    @property
    def position(self) -> Floats:
        """Present set posture, rad, (n,)."""
        position: Floats = self._samples[self._index, 0]
        return position

    @property
    def velocity(self) -> Floats:
        """Present set velocity, rad/s, (n,)."""
        velocity: Floats = self._samples[self._index, 1]
        return velocity
