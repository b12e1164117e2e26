"""What an arm follows: one reference at a time, braked whenever the reference or the force on the tool demands it."""

from __future__ import annotations

from collections import deque

from pcmrs.devices.motion.force import FlangeForce, ForceGuard, ForceSettings
from pcmrs.devices.motion.limits import check_press, check_trajectory
from pcmrs.devices.motion.press import Press, Relief
from pcmrs.devices.motion.reference import Reference, SetPoint
from pcmrs.devices.motion.servo import Servo
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.trajectory import brake
from pcmrs.messages import DeviceEvent, JointTrajectory, PressRequest
from pcmrs.spatial import Floats


class Follower:
    """Pure: nothing moves but by `advance`.

    Args:
        model: The arm as everybody knows it.
        brake_limits: With which it brakes; of the joints only.
        force: When the force on the tool is too great, and how it is relieved.
        sensor: Of that force.
        posture: Where the arm stands, rad, (n,).
        step: Time between samples, s.

    Attributes:
        reference: What it follows.
        stopped: Why the last motion did not go to its end.
        alarms: What is to be reported, oldest first.
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
        """Takes a trajectory for its reference.

        Raises:
            DeviceError: The trajectory does not start here or leaves the limits of the arm.
        """
        check_trajectory(trajectory, self.reference.position, self._model.facts)
        self._begin(Reference.along(trajectory, self.reference, self._step))

    def press(self, request: PressRequest) -> Press:
        """Begins to press; the arm must be at rest.

        Raises:
            DeviceError: The request is beyond what is gentle.
        """
        check_press(request)
        press = Press(self._model, self.reference.position, request, self._force, self._step)
        self._begin(press)
        return press

    def servo(self) -> Servo:
        """Waits for set points from now on; the arm must be at rest."""
        servo = Servo(self.reference.position, self._model.facts, self._brake_limits, self._step, self._deadman)
        self._begin(servo)
        return servo

    @property
    def relieving(self) -> bool:
        """Whether it gives way to a force on the tool."""
        return isinstance(self.reference, Relief)

    def hold(self, reason: str | None = "held") -> None:
        """Brakes from the present reference as fast as the limits allow.

        Args:
            reason: Why, where the reference itself knows no better; None for the end that the motion was meant to have.
        """
        present = self.reference
        if present.alarm is not None:
            self.alarms.append(present.alarm)
        if isinstance(present, Relief):
            self._relief_left -= present.travelled
        if not present.ended:
            self.stopped = self.stopped or present.halt or reason
        if present is self._braking:
            return  # a brake that began anew would begin gently, and who asks again and again would never stop the arm
        stop = brake(present.position.tolist(), present.velocity.tolist(), self._brake_limits)
        self.reference = self._braking = Reference.along(stop, present, self._step)

    def stand(self, posture: Floats, reason: str | None = None) -> None:
        """Stands at a posture, rad, (n,), whatever it followed; `reason` says why that was stopped."""
        if not self.reference.ended:
            self.stopped = self.stopped or reason
        self.reference = Reference.standing(posture)

    def advance(self) -> Floats:
        """The next sample: position, velocity and acceleration, (3, n); brakes where that is demanded."""
        self.supervise()
        return self.reference.advance()

    def supervise(self) -> None:
        """Brakes, or gives way, where the reference or the force on the tool demands it."""
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
    """Limits with which every joint brakes, rad/s^2 and rad/s^3."""
    joints = len(facts.joints)
    return MotionLimits(
        joint_velocity=tuple(joint.velocity for joint in facts.joints),
        joint_acceleration=(acceleration,) * joints,
        joint_jerk=(jerk,) * joints,
        # Braking has no path in space, so nothing reads the limits of the tool.
        linear_velocity=1.0,
        linear_acceleration=1.0,
        linear_jerk=1.0,
        angular_velocity=1.0,
        angular_acceleration=1.0,
    )
