"""Pressing gently by admittance, and giving way to a force that is too great."""

from __future__ import annotations

import numpy as np

from pcmrs.devices.motion.axis import AxisMotion
from pcmrs.devices.motion.force import FlangeForce
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import DeviceEvent, PressRequest
from pcmrs.spatial import Floats

RESISTANCE = 500.0
"""D of the admittance ``v = (F_target - F) / D``, N s/m: 3 N approach at 6 mm/s, and on a skin of 1 kN/m the force
comes within 5 % in 1.5 s without overshoot."""
TOLERANCE = 0.3
"""The force is reached within this, N."""
STEADY = 0.5
"""And has to stay so for this, s."""
TOUCHED = 0.5
"""Less force than this is no contact, N."""
RELIEF_SPEED = 0.02
"""At which the tool gives way, m/s."""
RELIEVED = 1.0
"""It does so until the force is below this, N."""


class Press(AxisMotion):
    """Goes along an axis with a speed that the missing force gives.

    Args:
        model: The arm as the controller knows it.
        position: Where it begins, at rest, rad, (n,).
        request: What is asked for.
        sensor: Of the force on the flange.
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
        """With which the tool presses now, N."""
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
    """Goes back along the tool's axis until the force has gone or the travel has, then halts with an alarm.

    Args:
        model: The arm as the controller knows it.
        position: Where it begins, rad, (n,).
        velocity: What still moves then, rad/s, (n,).
        travel: Longest way, m; 0 to halt at once.
        sensor: Of the force on the flange.
        limit: That the force exceeded, N.
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
            f"{self.travelled * 1e3:.1f} mm. Look at the tool before going on."
        )
        fields = {"force": self._force, "limit": self._limit, "relieved": self.travelled}
        return DeviceEvent(device="robot", code="force_limit", text=text, danger=True, fields=fields)

    def _wanted(self) -> float:
        if self._at_end or self._sensor.magnitude < RELIEVED:
            self.halt = "force_limit"
        return RELIEF_SPEED
