"""The arm in MuJoCo under a joint-impedance controller with integral action, stepped at 1 kHz."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.trajectory import MotionLimits, brake
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform
from sim.limits import check_trajectory
from sim.phantom import Phantom
from sim.plant import STEP, nominal_model, plant_model
from sim.reference import Reference
from sim.settings import ArmSettings

DAMPING_RATIO = 0.7
REST_ERROR = 5e-5  # rad; about 0.03 mm at the flange
REST_SPEED = 1e-3  # rad/s
SETTLING_STEPS = 2000  # at the start, until the integral action holds the arm against what the model gets wrong


class Arm:
    """A pure simulation: nothing moves but by `step`.

    The torque is ``inverse dynamics of the reference by the nominal model + K e + D de/dt + integral of Ki e``
    with ``e`` the reference minus the measured posture (joint impedance as in Albu-Schaeffer et al., A unified
    passivity-based control framework for position, torque and impedance control of flexible joint robots,
    IJRR 2007, for rigid joints and with integral action).

    Args:
        facts: The arm.
        settings: Its imperfections and its controller.
        flange_from_coil: Where the tool truly sits.
        phantom: What stands before the arm, and the tool it carries for that.
        rng: Draws the errors of the nominal model.
    """

    def __init__(
        self,
        facts: ArmFacts,
        settings: ArmSettings,
        flange_from_coil: Transform,
        phantom: Phantom,
        rng: np.random.Generator,
    ) -> None:
        self._plant = plant_model(facts, settings, flange_from_coil, phantom)
        self._nominal = nominal_model(facts, settings, flange_from_coil, phantom, rng)
        self._data = mujoco.MjData(self._plant)
        self._nominal_data = mujoco.MjData(self._nominal)
        self._data.qpos[:] = settings.home
        self._stiffness = np.array(settings.stiffness)
        self._damping = 2 * DAMPING_RATIO * np.sqrt(self._stiffness * _joint_inertias(self._nominal, settings.home))
        self._integral_gain = self._stiffness * settings.integral_rate * STEP
        self._integral = np.zeros(7)
        self._error = np.zeros(7)
        self._facts = facts
        self._brake_limits = _brake_limits(facts, settings)
        self.reference = Reference.standing(np.array(settings.home))
        self.step(SETTLING_STEPS)

    def step(self, steps: int) -> None:
        """Advances control and physics by `steps` steps of `STEP` seconds."""
        data, nominal = self._data, self._nominal_data
        position, velocity, torque = data.qpos, data.qvel, data.ctrl
        error, integral = self._error, self._integral
        for _ in range(steps):
            nominal.qpos[:], nominal.qvel[:], nominal.qacc[:] = wanted = self.reference.advance()
            mujoco.mj_inverse(self._nominal, nominal)
            np.subtract(wanted[0], position, out=error)
            integral += self._integral_gain * error
            torque[:] = (
                nominal.qfrc_inverse + integral + self._stiffness * error + self._damping * (wanted[1] - velocity)
            )
            mujoco.mj_step(self._plant, data)

    def follow(self, trajectory: JointTrajectory) -> None:
        """Takes a new reference.

        Raises:
            DeviceError: The trajectory does not start here or leaves the limits of the arm.
        """
        check_trajectory(trajectory, self.reference.position, self._facts)
        self.reference = Reference.along(trajectory, self.reference)

    def hold(self) -> None:
        """Brakes from the present reference as fast as the settings allow."""
        present = self.reference
        stop = brake(present.position.tolist(), present.velocity.tolist(), self._brake_limits)
        self.reference = Reference.along(stop, present)

    @property
    def at_rest(self) -> bool:
        """Whether the reference has ended and the arm stands still on it."""
        return (
            self.reference.ended
            and bool(np.abs(self._error).max() < REST_ERROR)
            and bool(np.abs(self._data.qvel).max() < REST_SPEED)
        )

    @property
    def positions(self) -> Floats:
        """Measured joint positions, rad, (7,)."""
        return np.array(self._data.qpos)

    @property
    def velocities(self) -> Floats:
        """Measured joint velocities, rad/s, (7,)."""
        return np.array(self._data.qvel)

    @property
    def torques(self) -> Floats:
        """Commanded joint torques, N m, (7,)."""
        return np.array(self._data.ctrl)


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


def _joint_inertias(model: Any, posture: tuple[float, ...]) -> Floats:
    """Diagonal of the joint-space inertia matrix at a posture, kg m^2, (7,)."""
    data = mujoco.MjData(model)
    data.qpos[:] = posture
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    return np.diag(inertia).copy()
