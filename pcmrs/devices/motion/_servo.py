"""A reference that approaches streamed set points within the limits of the arm."""

from __future__ import annotations

import numpy as np
from ruckig import InputParameter, Ruckig, Synchronization, Trajectory

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.messages import DeviceEvent, JointSetpoint
from pcmrs.spatial import Floats

DEADMAN = 0.1
"""Default time without a fresh set point after which the session ends, s of the cell."""
FIRST = 1.0
"""Additional time until the first set point, before which nothing moves, s of the cell."""
LARGEST_JUMP = 0.2
"""Greatest distance of a set point from the present set posture, rad in any joint; a farther one is refused."""
MOST_SPEED = 0.98
"""Part of a joint's speed limit that the velocity of a set point may use, so that the arm can catch up with it."""


class Servo:
    """A reference that meets a moving target as soon as its limits allow, and then moves with it.

    In the frame of a target that moves on with its velocity, the arm must come to rest at zero. So each set point gives
    one time-optimal profile of bounded jerk (Berscheid, Kröger, RSS 2021), whose speed limits are those of the arm less
    the speed of the target. After that the reference moves with the target, without lag.

    Args:
        posture: Start posture, at rest, rad, (n,).
        facts: Data of the arm, with the limits of its joints.
        limits: Acceleration and jerk limits of the joints, with which it can also brake.
        step: Time between samples, s.
        deadman: Time without a fresh set point after which the session ends, s of the cell; see `DEADMAN`.

    Attributes:
        deadman: As above.
        number: Number of the last set point.
        halt: Reason why the arm must brake now; None if it need not.
        alarm: Event to report then.
    """

    ended = False

    def __init__(
        self, posture: Floats, facts: ArmFacts, limits: MotionLimits, step: float, deadman: float = DEADMAN
    ) -> None:
        self.deadman = deadman
        joints = len(facts.joints)
        self._lower = np.array([joint.lower for joint in facts.joints])
        self._upper = np.array([joint.upper for joint in facts.joints])
        self._speed = np.array([joint.velocity for joint in facts.joints])
        self._acceleration = np.array(limits.joint_acceleration)
        self._jerk = np.array(limits.joint_jerk)
        self._planner = Ruckig(joints)
        self._request = InputParameter(joints)
        self._request.synchronization = Synchronization.No
        self._request.max_acceleration = list(limits.joint_acceleration)
        self._request.max_jerk = list(limits.joint_jerk)
        self._profile = Trajectory(joints)
        self._sample = np.stack((posture, np.zeros(joints), np.zeros(joints)))
        self._target: tuple[Floats, Floats] | None = None
        self._step = step
        self._steps = -round(FIRST / step)  # since the last set point
        self.number = 0
        self.halt: str | None = None
        self.alarm: DeviceEvent | None = None

    def take(self, setpoint: JointSetpoint) -> None:
        """Approach a new target, or halt if it must not be followed."""
        position, velocity = np.array(setpoint.positions), np.array(setpoint.velocities)
        self.number = setpoint.number
        if not self._allowed(position, velocity):
            return
        velocity = np.clip(velocity, -MOST_SPEED * self._speed, MOST_SPEED * self._speed)
        present, request = self._sample, self._request
        request.max_velocity = (self._speed - velocity).tolist()
        request.min_velocity = (-self._speed - velocity).tolist()
        request.current_position = (present[0] - position).tolist()
        request.current_velocity = (present[1] - velocity).tolist()
        request.current_acceleration = present[2].tolist()
        self._planner.calculate(request, self._profile)
        self._target, self._steps = (position, velocity), 0

    def advance(self) -> Floats:
        """Return the next sample: position, velocity and acceleration, (3, n)."""
        self._steps += 1
        if self._steps * self._step > self.deadman:
            self._refuse("no_set_point", f"no set point came for {self.deadman:g} s", limit=self.deadman)
        if self._target is not None:
            position, velocity = self._target
            time = self._steps * self._step
            sample = np.array(self._profile.at_time(time))
            sample[0] += position + velocity * time
            sample[1] += velocity
            self._sample = sample
            self._check_room()
        return self._sample

    @property
    def position(self) -> Floats:
        """Present set posture, rad, (n,)."""
        position: Floats = self._sample[0]
        return position

    @property
    def velocity(self) -> Floats:
        """Present set velocity, rad/s, (n,)."""
        velocity: Floats = self._sample[1]
        return velocity

    def _allowed(self, position: Floats, velocity: Floats) -> bool:
        joints = self._speed.shape
        if position.shape != joints or velocity.shape != joints or not np.isfinite((position, velocity)).all():
            self._refuse("malformed", f"a set point does not hold {joints[0]} finite positions and velocities")
        elif (excess := float(np.maximum(self._lower - position, position - self._upper).max())) > 0.0:
            text = f"a set point lies {excess:.4f} rad outside the range of a joint"
            self._refuse("out_of_range", text, excess=excess)
        elif (jump := float(np.abs(position - self.position).max())) > LARGEST_JUMP:
            text = f"a set point lies {jump:.3f} rad from the present posture, limit {LARGEST_JUMP} rad"
            self._refuse("jump", text, jump=jump, limit=LARGEST_JUMP)
        return self.halt is None

    def _check_room(self) -> None:
        """Halt as long as the arm can still brake before the limits of its joints."""
        speed = np.abs(self.velocity) + self._acceleration * self._step  # greatest speed at the next check
        ahead = np.where(self.velocity > 0.0, self._upper - self.position, self.position - self._lower)
        room = ahead - _braking_distance(speed, self._acceleration, self._jerk) - 2 * self._step * speed
        joint = int(room.argmin())
        if room[joint] < 0.0 and self.velocity[joint] != 0.0:
            self._refuse("joint_limit", f"joint {joint + 1} moves too fast towards its limit", joint=joint + 1)

    def _refuse(self, reason: str, text: str, **fields: float) -> None:
        if self.halt is not None:
            return
        self.halt = reason
        self.alarm = DeviceEvent(
            device="robot",
            code="servo_held",
            text=f"The robot brakes and ends the servo session: {text}.",
            danger=True,
            fields={"reason": reason, **fields},
        )


def _braking_distance(speed: Floats, acceleration: Floats, jerk: Floats) -> Floats:
    """Return the distance to rest from a constant `speed` with bounded acceleration and jerk, rad, (n,)."""
    ramps = np.sqrt(speed / jerk)  # duration of each ramp if the acceleration does not reach its limit, s
    distance: Floats = speed * np.where(
        ramps * jerk <= acceleration, ramps, (speed / acceleration + acceleration / jerk) / 2
    )
    return distance
