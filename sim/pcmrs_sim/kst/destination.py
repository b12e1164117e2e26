"""What the arm follows in a direct servo: the newest set point, as smoothly as its limits allow."""

from __future__ import annotations

import numpy as np
from ruckig import InputParameter, Ruckig, Synchronization, Trajectory

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.spatial import Floats
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import ArmSettings

LARGEST_JUMP = 0.1
"""A set point farther than this from the one before ends the servo, rad in any joint."""


class Destination:
    """A reference that goes for the last set point and stays there; there is no deadman.

    From one set point to the next it is a time-optimal profile of bounded jerk that ends at rest (Berscheid, Kröger,
    RSS 2021), so that the arm is late in a quick stream and exact at its end. The real server shapes the last
    millimetre more slowly than this.

    Args:
        posture: Where it begins, at rest, rad, (n,).
        facts: The arm and its limits.
        settings: Acceleration and jerk of its joints.
        part: Of the arm's speeds and accelerations that the servo may use.

    Attributes:
        halt: Why the arm must brake now.
        alarm: Always None: the cabinet tells its client, nobody else.
    """

    ended = False
    alarm = None

    def __init__(self, posture: Floats, facts: ArmFacts, settings: ArmSettings, part: float = 1.0) -> None:
        joints = len(facts.joints)
        self._lower = np.array([joint.lower for joint in facts.joints])
        self._upper = np.array([joint.upper for joint in facts.joints])
        self._planner = Ruckig(joints)
        self._request = InputParameter(joints)
        self._request.synchronization = Synchronization.No
        self._request.max_velocity = [part * joint.velocity for joint in facts.joints]
        self._request.max_acceleration = [part * settings.brake_acceleration] * joints
        self._request.max_jerk = [settings.brake_jerk] * joints
        self._profile = Trajectory(joints)
        self._target = posture
        self._sample = np.stack((posture, np.zeros(joints), np.zeros(joints)))
        self._steps = 0
        self._going = False
        self.halt: str | None = None

    def take(self, target: Floats) -> None:
        """Goes for a new set point, rad, (n,), or halts where that must not be followed."""
        if np.any(target < self._lower) or np.any(target > self._upper):
            self.halt = "out_of_range"
        elif np.abs(target - self._target).max() > LARGEST_JUMP:
            self.halt = "jump"
        elif not np.array_equal(target, self._target):
            self._go(target)

    def advance(self) -> Floats:
        """The next sample, (3, n)."""
        self._steps += 1
        if self._going:
            self._sample = np.array(self._profile.at_time(self._steps * STEP))
        return self._sample

    @property
    def position(self) -> Floats:
        """The present set posture, rad, (n,)."""
        position: Floats = self._sample[0]
        return position

    @property
    def velocity(self) -> Floats:
        """Its velocity, rad/s, (n,)."""
        velocity: Floats = self._sample[1]
        return velocity

    def _go(self, target: Floats) -> None:
        request = self._request
        request.current_position, request.current_velocity, request.current_acceleration = self._sample.tolist()
        request.target_position = target.tolist()
        self._planner.calculate(request, self._profile)
        self._target, self._steps, self._going = target, 0, True
