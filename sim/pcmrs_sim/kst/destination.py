"""References of the arm in a direct servo: towards the newest set point, within the limits of the joints."""

from __future__ import annotations

import numpy as np
from ruckig import ControlInterface, InputParameter, Ruckig, Synchronization, Trajectory

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.spatial import Floats
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import ArmSettings

LARGEST_JUMP = 0.1
"""Difference between successive set points, in any joint, above which the servo ends, rad."""


class _Servo:
    """A reference along time-optimal profiles of bounded jerk. It has no deadman.

    The profiles are those of Berscheid, Kröger, Jerk-limited Real-time Trajectory Generation with Arbitrary Target
    States, RSS 2021.

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
        self._sample = np.stack((posture, np.zeros(joints), np.zeros(joints)))
        self._steps = 0
        self._moving = False
        self.halt: str | None = None

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

    def _plan(self) -> None:
        """Plan the profile to the target of the request, from the present sample."""
        request = self._request
        request.current_position, request.current_velocity, request.current_acceleration = self._sample.tolist()
        self._planner.calculate(request, self._profile)
        self._steps, self._moving = 0, True


class Destination(_Servo):
    """A reference that moves to the last set point and stays there.

    The arm lags behind a fast stream, and is exact at its end. The real server shapes the last millimetre more slowly.

    Args:
        posture: Posture at the start, at rest, rad, (n,).
        facts: Geometry and limits of the arm.
        settings: Acceleration and jerk of its joints.
        fraction: Fraction of the arm's speeds and accelerations that the servo may use.

    Attributes:
        target: Last set point, rad, (n,).
    """

    def __init__(self, posture: Floats, facts: ArmFacts, settings: ArmSettings, fraction: float = 1.0) -> None:
        super().__init__(posture, facts, settings, fraction)
        self.target = posture

    def take(self, target: Floats) -> None:
        """Take a new set point, rad, (n,), or set `halt` if it is out of range or too far away."""
        if np.any(target < self._lower) or np.any(target > self._upper):
            self.halt = "out_of_range"
        elif np.abs(target - self.target).max() > LARGEST_JUMP:
            self.halt = "jump"
        elif not np.array_equal(target, self.target):
            self.target = target
            self._request.target_position = target.tolist()
            self._plan()


class VelocityDestination(_Servo):
    """A reference whose joints turn with the last velocities, until a joint could no longer stop within its range.

    Args:
        posture: Posture at the start, at rest, rad, (n,).
        facts: Geometry and limits of the arm.
        settings: Acceleration and jerk of its joints.
    """

    def __init__(self, posture: Floats, facts: ArmFacts, settings: ArmSettings) -> None:
        super().__init__(posture, facts, settings)
        self._request.control_interface = ControlInterface.Velocity
        self._brake_acceleration = settings.brake_acceleration
        self._velocities = np.zeros(len(facts.joints))

    def take(self, velocities: Floats) -> None:
        """Take new velocities, rad/s, (n,), or set `halt` if one is greater than that of its joint."""
        if np.any(np.abs(velocities) > self._request.max_velocity):
            self.halt = "too_fast"
        elif not np.array_equal(velocities, self._velocities):
            self._velocities = velocities
            self._request.target_velocity = velocities.tolist()
            self._plan()

    def advance(self) -> Floats:
        """Return the next sample as `SetPoint.advance` does; set `halt` if a joint must brake for its range."""
        sample = super().advance()
        rest = sample[0] + sample[1] * np.abs(sample[1]) / (2.0 * self._brake_acceleration)
        if np.any(rest < self._lower) or np.any(rest > self._upper):
            self.halt = "out_of_range"
        return sample
