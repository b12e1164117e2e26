"""A reference that goes along one axis of the tool at a speed that is decided at every step."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import DeviceEvent
from pcmrs.spatial import Floats

DAMPING = 0.01
"""Of the inverse of the Jacobian (Nakamura, Hanafusa 1986; Wampler 1986): joints stay slow near singularities."""
LAG = 0.02
"""Time constant with which the speed follows what is wanted, and what was moving before fades out, s."""
SLOWING = 0.1
"""Time constant with which the tool runs out at the end of its travel, s."""
NEAR = 5e-5
"""A travel that lacks no more than this is at its end, m."""

_DAMPED = DAMPING**2 * np.eye(6)


class AxisMotion(ABC):
    """Keeps the orientation of the flange and moves it by ``dq = J^T (J J^T + damping^2 I)^-1 (axis v, 0)``.

    Args:
        model: The arm as the controller knows it.
        position: Where it begins, rad, (n,).
        velocity: What still moves then, rad/s, (n,).
        axis_in_flange: Unit vector, (3,).
        travel: Longest way along it, m.
        step: Time between samples, s.

    Attributes:
        ended: It stands still for good.
        halt: Why the arm must brake now.
        travelled: Way along the axis, m.
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
        """The speed wanted along the axis now, m/s; may set `ended` or `halt`."""

    def advance(self) -> Floats:
        """The next sample, (3, n)."""
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
        """What to report when it is held."""
        return None

    @property
    def position(self) -> Floats:
        """The present set posture, rad, (n,)."""
        return self._position.copy()

    @property
    def velocity(self) -> Floats:
        """Its velocity, rad/s, (n,)."""
        return np.zeros_like(self._velocity) if self.ended else self._velocity

    @property
    def _at_end(self) -> bool:
        return self._travel - self.travelled < NEAR

    def _joint_velocity(self) -> Floats:
        jacobian = self._model.jacobian(self._position)
        damped = jacobian @ jacobian.T + _DAMPED
        velocity: Floats = jacobian.T @ np.linalg.solve(damped, self._speed * self._twist)
        return velocity
