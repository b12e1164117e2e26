"""Follower of references: one at a time, braked whenever the reference or the force on the tool demands it."""

from __future__ import annotations

from collections import deque

from pcmrs.devices.motion._limits import check_press, check_trajectory
from pcmrs.devices.motion._servo import Servo
from pcmrs.devices.motion.force import FlangeForce, ForceGuard, ForceSettings
from pcmrs.devices.motion.press import PressMotion, Relief
from pcmrs.devices.motion.reference import Reference, SetPoint
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.trajectory import brake
from pcmrs.messages import DeviceEvent, JointTrajectory, PressRequest
from pcmrs.spatial import Floats


class Follower:
    """Source of the set points of an arm. Pure: only `advance` moves the reference.

    Args:
        model: Model of the arm.
        brake_limits: Limits of the joints with which it brakes.
        force: Limits of the force on the tool, and its relief.
        sensor: Estimate of that force.
        posture: Posture of the arm at rest, rad, (n,).
        step: Time between samples, s.

    Attributes:
        reference: Present reference.
        stopped: Reason why the last motion did not reach its end; None if it did.
        alarms: Events to be reported, oldest first.
    """

    def __init__(
        self,
        model: ArmModel,
        brake_limits: MotionLimits,
        force: ForceSettings,
        sensor: FlangeForce,
        posture: Floats,
        step: float,
    ) -> None:
        self._model = model
        self._brake_limits = brake_limits
        self._guard, self._relief = ForceGuard(force.force_limit), force.relief_mm * 1e-3
        self._relief_left = self._relief
        self._deadman = force.deadman
        self._force = sensor
        self._step = step
        self.stopped: str | None = None
        self.alarms: deque[DeviceEvent] = deque()
        self.reference: SetPoint = Reference.standing(posture)
        self._braking: SetPoint | None = None

    def follow(self, trajectory: JointTrajectory) -> None:
        """Follow a trajectory from now on.

        Raises:
            DeviceError: The trajectory does not start at the present posture, or leaves the limits of the arm.
        """
        check_trajectory(trajectory, self.reference.position, self._model.facts)
        self._begin(Reference.along(trajectory, self.reference, self._step))

    def press(self, request: PressRequest) -> PressMotion:
        """Start to press; the arm must be at rest.

        Raises:
            DeviceError: A value of the request is out of range.
        """
        check_press(request)
        press = PressMotion(self._model, self.reference.position, request, self._force, self._step)
        self._begin(press)
        return press

    def servo(self) -> Servo:
        """Follow set points from now on; the arm must be at rest."""
        servo = Servo(self.reference.position, self._model.facts, self._brake_limits, self._step, self._deadman)
        self._begin(servo)
        return servo

    @property
    def relieving(self) -> bool:
        """True if the arm gives way to a force on the tool."""
        return isinstance(self.reference, Relief)

    def hold(self, reason: str | None = "held") -> None:
        """Brake from the present reference as fast as the limits allow.

        Args:
            reason: Reason for the stop if the reference itself has none; None for the regular end of a motion.
        """
        present = self.reference
        if present.alarm is not None:
            self.alarms.append(present.alarm)
        if isinstance(present, Relief):
            self._relief_left -= present.travelled
        if not present.ended:
            self.stopped = self.stopped or present.halt or reason
        if present is self._braking:
            return  # a brake starts gently: one that is restarted by every request would never stop the arm
        stop = brake(present.position.tolist(), present.velocity.tolist(), self._brake_limits)
        self.reference = self._braking = Reference.along(stop, present, self._step)

    def stand(self, posture: Floats, reason: str | None = None) -> None:
        """Stand at a posture from now on.

        Args:
            posture: Posture, rad, (n,).
            reason: Reason for which the present motion is stopped; None for its regular end.
        """
        if not self.reference.ended:
            self.stopped = self.stopped or reason
        self.reference = Reference.standing(posture)

    def advance(self) -> Floats:
        """Return the next sample: position, velocity and acceleration, (3, n); brakes if that is demanded."""
        self.supervise()
        return self.reference.advance()

    def supervise(self) -> None:
        """Brake, or give way, if the reference or the force on the tool demands it."""
        reference = self.reference
        if reference.halt is not None:
            self.hold()
        if self._guard.exceeded(self._force.magnitude) and not isinstance(reference, Relief):
            self.stopped = self.stopped or "force_limit"
            self.reference = Relief(
                self._model,
                reference.position,
                reference.velocity,
                max(0.0, self._relief_left),
                self._force,
                self._guard.limit,
                self._step,
            )

    def _begin(self, reference: SetPoint) -> None:
        self.reference = reference
        self.stopped, self._relief_left = None, self._relief


def brake_limits(facts: ArmFacts, acceleration: float, jerk: float) -> MotionLimits:
    """Return the limits with which the joints brake.

    Args:
        facts: Data of the arm, with the speed limits of its joints.
        acceleration: Acceleration limit of every joint, rad/s^2.
        jerk: Jerk limit of every joint, rad/s^3.
    """
    joints = len(facts.joints)
    return MotionLimits(
        joint_velocity=tuple(joint.velocity for joint in facts.joints),
        joint_acceleration=(acceleration,) * joints,
        joint_jerk=(jerk,) * joints,
        # Braking follows no Cartesian path, so the limits of the tool are not used.
        linear_velocity=1.0,
        linear_acceleration=1.0,
        linear_jerk=1.0,
        angular_velocity=1.0,
        angular_acceleration=1.0,
    )
