"""Pressing gently by admittance, and giving way to a force that is too great."""

from __future__ import annotations

import numpy as np

from pcmrs.devices.motion._axis import AxisMotion
from pcmrs.devices.motion.force import FlangeForce
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import DeviceEvent, PressRequest
from pcmrs.spatial import Floats

RESISTANCE = 500.0
"""Damping D of the admittance ``v = (F_target - F) / D``, N s/m.

With 3 N the tool approaches at 6 mm/s. On skin of 1 kN/m the force is within 5 % after 1.5 s, without overshoot.
"""
TOLERANCE = 0.3
"""Greatest difference between the force and its target, N."""
STEADY = 0.5
"""Time for which the force must stay within `TOLERANCE`, s."""
TOUCHED = 0.5
"""Least force of a contact, N."""
RELIEF_SPEED = 0.02
"""Speed at which the tool gives way, m/s."""
RELIEVED = 1.0
"""Force below which the tool stops giving way, N."""


class PressMotion(AxisMotion):
    """Motion along an axis with a speed in proportion to the missing force.

    Args:
        model: Model of the arm in the controller.
        position: Start posture, at rest, rad, (n,).
        request: Force, direction and limits of the press.
        sensor: Estimate of the force on the flange.
        step: Time between samples, s.
    """

    def __init__(
        self, model: ArmModel, position: Floats, request: PressRequest, sensor: FlangeForce, step: float
    ) -> None:
        direction = np.array(request.direction_in_flange)
        super().__init__(model, position, np.zeros_like(position), direction, request.travel, step)
        self._request = request
        self._direction = direction
        self._sensor = sensor
        self._time = self._steady = 0.0

    @property
    def force(self) -> float:
        """Present force of the tool along the direction of the press, N."""
        return -float(self._direction @ self._sensor.flange_force)

    def _wanted(self) -> float:
        request = self._request
        missing = request.force - self.force
        self._time += self._step
        self._steady = self._steady + self._step if abs(missing) <= TOLERANCE else 0.0
        if self._steady >= STEADY:
            self.ended = True
        elif self._at_end and missing > TOLERANCE:
            self.halt = "no_contact" if self.force < TOUCHED else "travel_limit"
        elif self._time >= request.timeout:
            self.halt = "timeout"
        return min(max(missing / RESISTANCE, -request.speed), request.speed)


class Relief(AxisMotion):
    """Motion back along the tool's axis until the force is gone or the travel is used up; then it halts with an alarm.

    Args:
        model: Model of the arm in the controller.
        position: Start posture, rad, (n,).
        velocity: Joint velocities at the start, rad/s, (n,).
        travel: Longest travel, m; 0 to halt at once.
        sensor: Estimate of the force on the flange.
        limit: Limit that the force has exceeded, N.
        step: Time between samples, s.
    """

    def __init__(
        self,
        model: ArmModel,
        position: Floats,
        velocity: Floats,
        travel: float,
        sensor: FlangeForce,
        limit: float,
        step: float,
    ) -> None:
        super().__init__(model, position, velocity, sensor.axis, travel, step)
        self._sensor = sensor
        self._force = sensor.magnitude
        self._limit = limit

    @property
    def alarm(self) -> DeviceEvent:
        text = (
            f"The force on the tool was {self._force:.1f} N, limit {self._limit:g} N; it was relieved by "
            f"{self.travelled * 1e3:.1f} mm. Look at the tool before you continue."
        )
        fields = {"force": self._force, "limit": self._limit, "relieved": self.travelled}
        return DeviceEvent(device="robot", code="force_limit", text=text, danger=True, fields=fields)

    def _wanted(self) -> float:
        if self._at_end or self._sensor.magnitude < RELIEVED:
            self.halt = "force_limit"
        return RELIEF_SPEED
