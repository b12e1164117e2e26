"""What is known of the arm behind the cabinet: where it was told to be, where it was measured, what it feels."""

from __future__ import annotations

from collections import deque

import numpy as np

from pcmrs.devices.kst.force import TorqueForce
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointState
from pcmrs.spatial import Floats

REST_ERROR = 5e-5
"""An arm this near to its set point has arrived, rad in any joint: about 0.03 mm at the flange."""
REST_SPEED = 1e-3
"""An arm that moves more slowly stands still, rad/s."""
SETTLING = 0.5
"""An arm that stands still is at rest even off its set point when that has not moved for so long, s."""
LAG = 0.2
"""How far an arm may lag behind its set points, s; direct servo interpolates over 40 ms."""


class MeasuredArm:
    """Readings and set points of one arm.

    Args:
        model: The arm.
        tool_axis: Unit vector of the tool's +z in the flange's axes, (3,).
        step: Time between set points of a stream that is not held up, s.

    Attributes:
        force: On the flange.
        positions: Measured joints, rad, (n,).
        velocities: By their differences, rad/s, (n,).
        captured: When they were measured at the latest asked for, s of the clock.
    """

    def __init__(self, model: ArmModel, tool_axis: Floats, step: float) -> None:
        self.force = TorqueForce(model, tool_axis)
        self.positions = self.velocities = self._torques = np.zeros(model.joints)
        self.captured = -np.inf
        self._lag = round(LAG / step)
        self._told: deque[tuple[float, Floats]] = deque()

    def take_joints(self, positions: Floats, captured: float) -> None:
        """A reading of the joints, rad, (n,), that was asked for at `captured`."""
        elapsed = captured - self.captured
        if np.isfinite(elapsed):
            self.velocities = (positions - self.positions) / elapsed
        self.positions, self.captured = positions, captured
        while len(self._told) > self._lag and self._told[self._lag][0] <= captured:
            self._told.popleft()  # not by their age: an arm is no farther behind when its stream was held up

    def take_torques(self, torques: Floats) -> None:
        """A reading of the external torques, N m, (n,)."""
        self._torques = torques
        self.force.update(self.positions, torques)

    def told(self, positions: Floats, time: float) -> None:
        """A set point was sent at `time`, rad, (n,)."""
        self._told.append((time, positions))

    def begin(self) -> None:
        """It is told to stay where it is, before a stream."""
        self._told.clear()
        self.told(self.positions, self.captured)

    @property
    def deviation(self) -> float:
        """How far the worst joint is from all it was told, from a little before the question until now, rad.

        When between question and answer the joints were measured is not known.
        """
        told = np.array([positions for _, positions in self._told])
        return float(np.maximum(told.min(axis=0) - self.positions, self.positions - told.max(axis=0)).max())

    def at_rest(self, target: Floats, ended: float) -> bool:
        """Whether it stands, on a set point `target`, rad, (n,), that has not moved since `ended`."""
        near = float(np.abs(self.positions - target).max()) < REST_ERROR or self.captured > ended + SETTLING
        return self.captured > ended and near and float(np.abs(self.velocities).max()) < REST_SPEED

    def state(self, now: float, *, moving: bool, relieving: bool) -> JointState:
        """The same as a message, sent `now`; its torques are the external ones."""
        return JointState(
            captured=self.captured,
            sent=now,
            positions=self.positions.tolist(),
            velocities=self.velocities.tolist(),
            torques=self._torques.tolist(),
            moving=moving,
            flange_force=self.force.flange_force,
            relieving=relieving,
        )
