"""The arm in MuJoCo under its controller, stepped at 1 kHz, with what it follows and what makes it brake."""

from __future__ import annotations

from collections import deque

import mujoco
import numpy as np

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.trajectory import MotionLimits, brake
from pcmrs.messages import DeviceEvent, JointTrajectory, PressRequest
from pcmrs.spatial import Floats, Transform
from sim.contact import Contact
from sim.controller import Controller
from sim.errors import displaced
from sim.force import ForceGuard, ForceSensor
from sim.limits import check_press, check_trajectory
from sim.phantom import Phantom
from sim.plant import STEP, nominal_model, plant_model
from sim.press import Press, Relief
from sim.reference import Reference, SetPoint
from sim.servo import Servo
from sim.settings import ArmSettings, ForceSettings, SimSettings

REST_ERROR = 5e-5  # rad; about 0.03 mm at the flange
REST_SPEED = 1e-3  # rad/s
SETTLING_STEPS = 2000  # at the start, until the integral action holds the arm against what the model gets wrong


class Arm:
    """A pure simulation: nothing moves but by `step`.

    Args:
        facts: The arm as everybody knows it; the true one differs from it by the geometry error.
        settings: Its imperfections, its controller and the seed of its errors.
        force: When the force on the tool is too great, and how it is relieved.
        phantom: What stands before the arm, and the tool it carries for that.

    Attributes:
        reference: What it follows.
        stopped: Why the last motion did not go to its end.
        alarms: What is to be reported, oldest first.
        contact: Between tool and body.
        sensor: The arm's own estimate of the force.
    """

    def __init__(self, facts: ArmFacts, settings: SimSettings, force: ForceSettings, phantom: Phantom) -> None:
        own, flange_from_coil = settings.arm, settings.geometry.flange_from_coil.transform
        true_facts = displaced(facts, own.geometry_error_mm * 1e-3, settings.seed)
        rng = np.random.default_rng(settings.seed)
        home = np.array(own.home or facts.home)
        self._facts = facts
        self._model, self._true_model = ArmModel(facts), ArmModel(true_facts)
        self._plant = plant_model(true_facts, own, flange_from_coil, phantom)
        self._data = mujoco.MjData(self._plant)
        self._data.qpos[:] = home
        self._controller = Controller(nominal_model(facts, own, flange_from_coil, phantom, rng), facts, own, home)
        self._brake_limits = _brake_limits(facts, own)
        self._guard, self._relief = ForceGuard(force.force_limit), force.relief_mm * 1e-3
        self._relief_left = self._relief
        self.contact = Contact(self._plant, phantom, settings.contact, STEP)
        self.sensor = ForceSensor(flange_from_coil.rotation[:, 2], own, STEP, rng)
        self.stopped: str | None = None
        self.alarms: deque[DeviceEvent] = deque()
        self.reference: SetPoint = Reference.standing(home)
        self.step(SETTLING_STEPS)

    def step(self, steps: int) -> None:
        """Advances control and physics by `steps` steps of `STEP` seconds."""
        data = self._data
        for _ in range(steps):
            self._supervise()
            data.ctrl[:] = self._controller.torque(self.reference.advance(), data.qpos, data.qvel)
            self.contact.apply(data)
            mujoco.mj_step(self._plant, data)
            self.sensor.update(self.contact.force)

    def follow(self, trajectory: JointTrajectory) -> None:
        """Takes a trajectory for its reference.

        Raises:
            DeviceError: The trajectory does not start here or leaves the limits of the arm.
        """
        check_trajectory(trajectory, self.reference.position, self._facts)
        self._begin(Reference.along(trajectory, self.reference))

    def press(self, request: PressRequest) -> Press:
        """Begins to press; the arm must be at rest.

        Raises:
            DeviceError: The request is beyond what is gentle.
        """
        check_press(request)
        press = Press(self._model, self.reference.position, request, self.sensor)
        self._begin(press)
        return press

    def servo(self) -> Servo:
        """Waits for set points from now on; the arm must be at rest."""
        servo = Servo(self.reference.position, self._facts, self._brake_limits)
        self._begin(servo)
        return servo

    def hold(self, reason: str | None = "held") -> None:
        """Brakes from the present reference as fast as the settings allow.

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
        stop = brake(present.position.tolist(), present.velocity.tolist(), self._brake_limits)
        self.reference = Reference.along(stop, present)

    @property
    def at_rest(self) -> bool:
        """Whether the reference has ended and the arm stands still on it."""
        return (
            self.reference.ended
            and bool(np.abs(self._controller.error).max() < REST_ERROR)
            and bool(np.abs(self._data.qvel).max() < REST_SPEED)
        )

    @property
    def positions(self) -> Floats:
        """Measured joint positions, rad, (n,)."""
        return np.array(self._data.qpos)

    @property
    def velocities(self) -> Floats:
        """Measured joint velocities, rad/s, (n,)."""
        return np.array(self._data.qvel)

    @property
    def torques(self) -> Floats:
        """Commanded joint torques, N m, (n,)."""
        return np.array(self._data.ctrl)

    def base_from_flange(self) -> Transform:
        """Where the flange truly is."""
        return self._true_model.forward(self.positions)

    def _begin(self, reference: SetPoint) -> None:
        self.reference = reference
        self.stopped, self._relief_left = None, self._relief

    def _supervise(self) -> None:
        """Brakes where the reference or the force on the tool demands it."""
        reference = self.reference
        if reference.halt is not None:
            self.hold()
        if self._guard.exceeded(self.sensor.magnitude) and not isinstance(reference, Relief):
            self.stopped = self.stopped or "force_limit"
            self.reference = Relief(
                self._model,
                reference.position,
                reference.velocity,
                max(0.0, self._relief_left),
                self.sensor,
                self._guard.limit,
            )


def _brake_limits(facts: ArmFacts, settings: ArmSettings) -> MotionLimits:
    joints = len(facts.joints)
    return MotionLimits(
        joint_velocity=tuple(joint.velocity for joint in facts.joints),
        joint_acceleration=(settings.brake_acceleration,) * joints,
        joint_jerk=(settings.brake_jerk,) * joints,
        # Braking has no path in space, so nothing reads the limits of the tool.
        linear_velocity=1.0,
        linear_acceleration=1.0,
        linear_jerk=1.0,
        angular_velocity=1.0,
        angular_acceleration=1.0,
    )
