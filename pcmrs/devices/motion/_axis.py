"""A reference along one axis of the tool, at a speed that is chosen at every step."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import DeviceEvent
from pcmrs.spatial import Floats

DAMPING = 0.01
"""Damping of the inverse Jacobian (Nakamura, Hanafusa 1986; Wampler 1986): keeps joints slow near singularities."""
LAG = 0.02
"""Time constant with which the speed follows the wanted one, and the earlier motion fades out, s."""
SLOWING = 0.1
"""Time constant with which the tool slows down at the end of its travel, s."""
END_TOLERANCE = 5e-5
"""Distance from the end of the travel at which it is reached, m."""

_DAMPED = DAMPING**2 * np.eye(6)


class AxisMotion(ABC):
    """Motion that keeps the flange's orientation and moves it by ``dq = J^T (J J^T + damping^2 I)^-1 (axis v, 0)``.

    Args:
        model: Model of the arm in the controller.
        position: Start posture, rad, (n,).
        velocity: Joint velocities at the start, rad/s, (n,).
        axis_in_flange: Unit vector of the axis in the flange frame, (3,).
        travel: Longest travel along the axis, m.
        step: Time between samples, s.

    Attributes:
        ended: True if the reference stands still for good.
        halt: Reason why the arm must brake now; None if it need not.
        travelled: Travel along the axis so far, m.
    """

    def __init__(
        self,
        model: ArmModel,
        position: Floats,
        velocity: Floats,
        axis_in_flange: Floats,
        travel: float,
        step: float,
    ) -> None:
        self._model = model
        self._position, self._carried = position.copy(), velocity.copy()
        self._velocity = velocity
        axis = model.forward(self._position).rotation @ axis_in_flange
        self._twist = np.concatenate((axis, np.zeros(3)))
        self._travel = travel
        self._step = step
        self._speed = 0.0
        self.travelled = 0.0
        self.ended = False
        self.halt: str | None = None

    @abstractmethod
    def _wanted(self) -> float:
        """Return the wanted speed along the axis, m/s; may set `ended` or `halt`."""

    def advance(self) -> Floats:
        """Return the next sample: position, velocity and acceleration, (3, n)."""
        wanted = min(self._wanted(), (self._travel - self.travelled) / SLOWING)
        if self.ended:
            return np.array((self._position, np.zeros_like(self._position), np.zeros_like(self._position)))
        step = self._step
        self._speed += (wanted - self._speed) * step / LAG
        self.travelled += self._speed * step
        self._carried *= 1 - step / LAG
        before = self._velocity
        self._velocity = self._carried + self._joint_velocity()
        self._position += self._velocity * step
        if not ((self._model.lower < self._position) & (self._position < self._model.upper)).all():
            self.halt = "joint_limit"
        return np.array((self._position, self._velocity, (self._velocity - before) / step))

    @property
    def alarm(self) -> DeviceEvent | None:
        """Event to report when the arm is held; None for no event."""
        return None

    @property
    def position(self) -> Floats:
        """Present set posture, rad, (n,)."""
        return self._position.copy()

    @property
    def velocity(self) -> Floats:
        """Present set velocity, rad/s, (n,)."""
        return np.zeros_like(self._velocity) if self.ended else self._velocity

    @property
    def _at_end(self) -> bool:
        return self._travel - self.travelled < END_TOLERANCE

    def _joint_velocity(self) -> Floats:
        jacobian = self._model.jacobian(self._position)
        damped = jacobian @ jacobian.T + _DAMPED
        velocity: Floats = jacobian.T @ np.linalg.solve(damped, self._speed * self._twist)
        return velocity
