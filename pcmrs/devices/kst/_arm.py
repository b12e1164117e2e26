"""State of the arm behind the cabinet: recent set points, measured joints, and external force."""

from __future__ import annotations

from collections import deque

import numpy as np

from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointState
from pcmrs.spatial import Floats

REST_ERROR = 5e-5
"""Distance from its set point at which an arm has arrived, rad in any joint: about 0.03 mm at the flange."""
REST_SPEED = 1e-3
"""Speed below which a joint stands still, rad/s."""
SETTLING = 0.5
"""Time after the last change of its set point after which an arm that stands still is at rest, even off it, s."""
LAG = 0.2
"""Greatest lag of an arm behind its set points, s; direct servo interpolates over 40 ms."""
DAMPING = 0.01
"""Damping of the inverse Jacobian: keeps the estimate finite at singularities and lowers it by about 1 % elsewhere."""


class TorqueForce:
    """Implementation of `pcmrs.devices.motion.force.FlangeForce` by least squares of ``tau = J^T wrench``.

    The wrench is ``(J J^T + damping^2 I)^-1 J tau``; for the statics see Siciliano et al., Robotics, 2009, section 3.8.

    Args:
        model: Model of the arm.
        axis_in_flange: Unit vector of the tool's +z in the flange's axes, along which contact pushes, (3,).

    Attributes:
        axis: As `axis_in_flange`.
        flange_force: External force along the flange's axes, N.
    """

    def __init__(self, model: ArmModel, axis_in_flange: Floats) -> None:
        self._model = model
        self.axis = axis_in_flange
        self.flange_force = (0.0, 0.0, 0.0)

    def update(self, positions: Floats, torques: Floats) -> None:
        """Update the estimate.

        Args:
            positions: Measured joints, rad, (n,).
            torques: External joint torques, N m, (n,).
        """
        jacobian = self._model.jacobian(positions)
        wrench = np.linalg.solve(jacobian @ jacobian.T + DAMPING**2 * np.eye(6), jacobian @ torques)
        x, y, z = (self._model.forward(positions).rotation.T @ wrench[:3]).tolist()
        self.flange_force = (x, y, z)

    @property
    def magnitude(self) -> float:
        """Magnitude of the force, N."""
        return float(np.linalg.norm(self.flange_force))


class MeasuredArm:
    """Readings and set points of one arm.

    Args:
        model: Model of the arm.
        tool_axis: Unit vector of the tool's +z in the flange's axes, (3,).
        step: Time between two set points of a stream that is not held up, s.

    Attributes:
        force: Estimate of the force on the flange.
        positions: Measured joints, rad, (n,).
        velocities: Joint velocities from the differences of `positions`, rad/s, (n,).
        captured: Time at which the measured joints were requested, s of the clock.
    """

    def __init__(self, model: ArmModel, tool_axis: Floats, step: float) -> None:
        self.force = TorqueForce(model, tool_axis)
        self.positions = self.velocities = self._torques = np.zeros(model.joints)
        self.captured = -np.inf
        self._lag = round(LAG / step)
        self._set_points: deque[tuple[float, Floats]] = deque()

    def take_joints(self, positions: Floats, captured: float) -> None:
        """Take a reading of the joints.

        Args:
            positions: Measured joints, rad, (n,).
            captured: Time at which they were requested, s of the clock.
        """
        elapsed = captured - self.captured
        if np.isfinite(elapsed):
            self.velocities = (positions - self.positions) / elapsed
        self.positions, self.captured = positions, captured
        while len(self._set_points) > self._lag and self._set_points[self._lag][0] <= captured:
            self._set_points.popleft()  # by number, not age: the arm lags no farther if its stream was held up

    def take_torques(self, torques: Floats) -> None:
        """Take a reading of the external torques, N m, (n,)."""
        self._torques = torques
        self.force.update(self.positions, torques)

    def add_set_point(self, positions: Floats, time: float) -> None:
        """Record a set point that was sent.

        Args:
            positions: Joint positions, rad, (n,).
            time: Time of sending, s of the clock.
        """
        self._set_points.append((time, positions))

    def begin(self) -> None:
        """Start a stream: the only set point is the measured posture."""
        self._set_points.clear()
        self.add_set_point(self.positions, self.captured)

    @property
    def deviation(self) -> float:
        """Distance of the worst joint from the range of its recent set points, rad.

        The range starts `LAG` before the request for the measured joints and ends now, because the time of the
        measurement between request and answer is unknown.
        """
        recent = np.array([positions for _, positions in self._set_points])
        return float(np.maximum(recent.min(axis=0) - self.positions, self.positions - recent.max(axis=0)).max())

    def at_rest(self, target: Floats, ended: float, settling: float = SETTLING) -> bool:
        """Return True if the arm stands at its last set point.

        Args:
            target: Last set point, rad, (n,).
            ended: Time since which the set point has not moved, s of the clock.
            settling: Time after `ended` after which an arm that stands still is at rest, even off its set point, s.
        """
        near = float(np.abs(self.positions - target).max()) < REST_ERROR or self.captured > ended + settling
        return self.captured > ended and near and float(np.abs(self.velocities).max()) < REST_SPEED

    def state(self, now: float, *, moving: bool, relieving: bool) -> JointState:
        """Return the readings as a message; its torques are the external ones.

        Args:
            now: Time of sending, s of the clock.
            moving: True if the arm moves.
            relieving: True if the arm gives way to a force on the tool.
        """
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
