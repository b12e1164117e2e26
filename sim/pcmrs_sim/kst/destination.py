"""Reference of the arm in a direct servo: towards the newest set point, within the limits of the joints."""

from __future__ import annotations

import numpy as np
from ruckig import InputParameter, Ruckig, Synchronization, Trajectory

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.spatial import Floats
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import ArmSettings

LARGEST_JUMP = 0.1
"""Difference between successive set points, in any joint, above which the servo ends, rad."""


class Destination:
    """A reference that moves to the last set point and stays there. It has no deadman.

    Between set points it is a time-optimal profile of bounded jerk that ends at rest (Berscheid, Kröger, Jerk-limited
    Real-time Trajectory Generation with Arbitrary Target States, RSS 2021). The arm therefore lags behind a fast
    stream, and is exact at its end. The real server shapes the last millimetre more slowly.

    Args:
        posture: Posture at the start, at rest, rad, (n,).
        facts: Geometry and limits of the arm.
        settings: Acceleration and jerk of its joints.
        fraction: Fraction of the arm's speeds and accelerations that the servo may use.

    Attributes:
        halt: Reason for which the arm must brake; None if it must not.
        alarm: Always None: the cabinet reports to its client only.
    """

    ended = False
    alarm = None

    def __init__(self, posture: Floats, facts: ArmFacts, settings: ArmSettings, fraction: float = 1.0) -> None:
        joints = len(facts.joints)
        self._lower = np.array([joint.lower for joint in facts.joints])
        self._upper = np.array([joint.upper for joint in facts.joints])
        self._planner = Ruckig(joints)
        self._request = InputParameter(joints)
        self._request.synchronization = Synchronization.No
        self._request.max_velocity = [fraction * joint.velocity for joint in facts.joints]
        self._request.max_acceleration = [fraction * settings.brake_acceleration] * joints
        self._request.max_jerk = [settings.brake_jerk] * joints
        self._profile = Trajectory(joints)
        self._target = posture
        self._sample = np.stack((posture, np.zeros(joints), np.zeros(joints)))
        self._steps = 0
        self._moving = False
        self.halt: str | None = None

    def take(self, target: Floats) -> None:
        """Take a new set point, rad, (n,), or set `halt` if it is out of range or too far away."""
        if np.any(target < self._lower) or np.any(target > self._upper):
            self.halt = "out_of_range"
        elif np.abs(target - self._target).max() > LARGEST_JUMP:
            self.halt = "jump"
        elif not np.array_equal(target, self._target):
            self._plan(target)

    def advance(self) -> Floats:
        """Return the next sample: position rad, velocity rad/s and acceleration rad/s^2, (3, n)."""
        self._steps += 1
        if self._moving:
            self._sample = np.array(self._profile.at_time(self._steps * STEP))
        return self._sample

    @property
    def position(self) -> Floats:
        """Present reference posture, rad, (n,)."""
        position: Floats = self._sample[0]
        return position

    @property
    def velocity(self) -> Floats:
        """Velocity of the reference, rad/s, (n,)."""
        velocity: Floats = self._sample[1]
        return velocity

    def _plan(self, target: Floats) -> None:
        request = self._request
        request.current_position, request.current_velocity, request.current_acceleration = self._sample.tolist()
        request.target_position = target.tolist()
        self._planner.calculate(request, self._profile)
        self._target, self._steps, self._moving = target, 0, True
