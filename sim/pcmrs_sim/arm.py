"""The arm in MuJoCo under its controller, stepped at 1 kHz, with what it follows and what makes it brake."""

from __future__ import annotations

import mujoco
import numpy as np

from pcmrs.devices.motion.follower import Follower, brake_limits
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.motion.reference import SetPoint
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.contact import Contact
from pcmrs_sim.disturbance import PlantDisturbance
from pcmrs_sim.errors import displaced
from pcmrs_sim.force import ForceSensor
from pcmrs_sim.impedance_controller import ImpedanceController
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.plant import STEP, nominal_model, plant_model
from pcmrs_sim.settings import SimSettings

REST_ERROR = 5e-5  # rad; about 0.03 mm at the flange
REST_SPEED = 1e-3  # rad/s
STILL_ERROR = 1e-6  # rad
STILL_SPEED = 1e-6  # rad/s
SETTLING_STEPS = 2000  # at the start, until the integral action holds the arm against what the model gets wrong


class Arm(Follower):
    """A pure simulation: nothing moves but by `step`.

    Args:
        facts: The arm as everybody knows it; the true one differs from it by the geometry error.
        settings: Its imperfections, its controller and the seed of its errors.
        force: When the force on the tool is too great, and how it is relieved.
        phantom: What stands before the arm, and the tool it carries for that.

    Attributes:
        contact: Between tool and body.
        sensor: The arm's own estimate of the force.
        disturbance: From outside the controller.
        stride: So many steps of what is around it may pass at once.
    """

    stride = 1

    def __init__(self, facts: ArmFacts, settings: SimSettings, force: ForceSettings, phantom: Phantom) -> None:
        own, flange_from_coil = settings.arm, settings.geometry.flange_from_coil.transform
        true_facts = displaced(facts, own.geometry_error_mm * 1e-3, settings.seed)
        rng = np.random.default_rng(settings.seed)
        home = np.array(own.home or facts.home)
        self.sensor = ForceSensor(flange_from_coil.rotation[:, 2], own, STEP, rng)
        limits = brake_limits(facts, own.brake_acceleration, own.brake_jerk)
        super().__init__(ArmModel(facts), limits, force, self.sensor, home, STEP)
        self._true_model = ArmModel(true_facts)
        self._plant = plant_model(true_facts, own, flange_from_coil, phantom)
        self._data = mujoco.MjData(self._plant)
        self._data.qpos[:] = home
        self._controller = ImpedanceController(
            nominal_model(facts, own, flange_from_coil, phantom, rng), facts, own, home
        )
        self.contact = Contact(self._plant, phantom, settings.contact, STEP)
        self.disturbance = PlantDisturbance(self._plant)
        self._posture, self._base_from_flange = home, self._true_model.forward(home)
        self.step(SETTLING_STEPS)

    def step(self, steps: int) -> None:
        """Advances control and physics by `steps` steps of `STEP` seconds.

        Of an arm that nothing moves only the noise of the force is simulated: most of the time it stands.
        """
        data = self._data
        for _ in range(self._steps_awake(steps)):
            data.ctrl[:] = self._controller.torque(self.disturbance.shifted(self.advance()), data.qpos, data.qvel)
            self.contact.apply(data)
            push = self.disturbance.apply(data)
            mujoco.mj_step(self._plant, data)
            self.sensor.update(self.contact.force + push)

    def _steps_awake(self, steps: int) -> int:
        """How many of `steps` are left after those for which the arm stands still, free, and undisturbed."""
        free = self.contact.clear(self._data) and self.disturbance.none
        if not (free and self._stands(STILL_ERROR, STILL_SPEED)):
            return steps
        while steps and self.reference.ended:
            self.supervise()
            self.sensor.update(0.0)
            steps -= 1
        return steps

    def track(self, reference: SetPoint) -> None:
        """Takes a reference of somebody else's making; the arm must be at rest."""
        self._begin(reference)

    @property
    def at_rest(self) -> bool:
        """Whether the reference has ended and the arm stands still on it."""
        return self._stands(REST_ERROR, REST_SPEED)

    def _stands(self, error: float, speed: float) -> bool:
        return (
            self.reference.ended
            and bool(np.abs(self._controller.error).max() < error)
            and bool(np.abs(self._data.qvel).max() < speed)
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
        if not np.array_equal(self._data.qpos, self._posture):
            self._posture = self.positions
            self._base_from_flange = self._true_model.forward(self._posture)
        return self._base_from_flange
