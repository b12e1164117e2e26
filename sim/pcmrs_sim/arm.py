"""The arm in MuJoCo under its controller, stepped at 1 kHz, with its reference and its brakes."""

from __future__ import annotations

import mujoco
import numpy as np

from pcmrs.devices.motion.follower import Follower, brake_limits
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.motion.reference import SetPoint
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.cell_state import CellState
from pcmrs_sim.contact import Contact
from pcmrs_sim.disturbance import PlantDisturbance
from pcmrs_sim.force import ForceSensor
from pcmrs_sim.impedance_controller import ImpedanceController
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.plant import STEP, nominal_model
from pcmrs_sim.settings import SimSettings

REST_ERROR = 5e-5
"""Largest control error of an arm at rest, rad: about 0.03 mm at the flange."""
REST_SPEED = 1e-3
"""Largest joint speed of an arm at rest, rad/s."""
STILL_ERROR = 1e-6
"""Control error below which the dynamics need no simulation, rad."""
STILL_SPEED = 1e-6
"""Joint speed below which the dynamics need no simulation, rad/s."""
SETTLING_STEPS = 2000
"""Steps at the start, in which the integral action settles against the errors of the nominal model."""


class Arm(Follower):
    """A pure simulation, which moves only in `step`.

    Args:
        facts: Nominal geometry and limits of the arm. The true ones differ by the geometry error.
        settings: Imperfections of the arm, its controller, and the seed of its errors.
        force: Limit of the force on the tool, and the relief from it.
        phantom: The body in front of the arm, and the tool for it.

    Attributes:
        cell: The model of the cell with this arm. Its dynamics have other data than the poses that are read.
        contact: Contact between tool and body.
        sensor: The arm's own estimate of the force.
        disturbance: Disturbances from outside the controller.
        stride: Largest number of steps between updates of the body's pose.
    """

    stride = 1

    def __init__(self, facts: ArmFacts, settings: SimSettings, force: ForceSettings, phantom: Phantom) -> None:
        own, flange_from_tool_tip = settings.arm, settings.geometry.flange_from_tool_tip.transform
        rng = np.random.default_rng(settings.seed)
        home = np.array(own.home or facts.home)
        self.sensor = ForceSensor(flange_from_tool_tip.rotation[:, 2], own, STEP, rng)
        limits = brake_limits(facts, own.brake_acceleration, own.brake_jerk)
        super().__init__(ArmModel(facts), limits, force, self.sensor, home, STEP)
        self.cell = CellState(facts, settings, phantom)
        self._plant = self.cell.model
        self._data = mujoco.MjData(self._plant)
        self._data.qpos[:] = home
        self._controller = ImpedanceController(
            nominal_model(facts, own, flange_from_tool_tip, phantom, rng), facts, own, home
        )
        self.contact = Contact(self._plant, phantom, settings.contact, STEP)
        self.disturbance = PlantDisturbance(self._plant)
        self.step(SETTLING_STEPS)

    def step(self, steps: int) -> None:
        """Advance control and physics by a number of steps of `STEP`.

        While the arm stands still, which is most of the time, only the noise of the force is simulated.
        """
        data = self._data
        for _ in range(self._skip_still_steps(steps)):
            reference = self.disturbance.apply_offset(self.advance())
            data.ctrl[:] = self._controller.torque(reference, data.qpos, data.qvel)
            self.contact.apply(data)
            push = self.disturbance.apply(data)
            mujoco.mj_step(self._plant, data)
            self.sensor.update(self.contact.force + push)

    def _skip_still_steps(self, steps: int) -> int:
        """Skip the dynamics while the arm stands still without contact and disturbance; return the remaining steps."""
        free = self.contact.clear(self._data) and self.disturbance.inactive
        if not (free and self._is_still(STILL_ERROR, STILL_SPEED)):
            return steps
        while steps and self.reference.ended:
            self.supervise()
            self.sensor.update(0.0)
            steps -= 1
        return steps

    def track(self, reference: SetPoint) -> None:
        """Follow a given reference. The arm must be at rest."""
        self._begin(reference)

    @property
    def at_rest(self) -> bool:
        """True if the reference has ended and the arm rests on it."""
        return self._is_still(REST_ERROR, REST_SPEED)

    def _is_still(self, error: float, speed: float) -> bool:
        """Return true if the reference has ended, with smaller control errors, rad, and joint speeds, rad/s."""
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

    def observe(self) -> CellState:
        """Return the model of the cell with the arm in its present posture."""
        self.cell.move_joints(self._data.qpos)
        return self.cell

    def base_from_flange(self) -> Transform:
        """Return the true pose of the flange; the same object as long as the arm stands still."""
        return self.observe().pose("world_from_flange")
