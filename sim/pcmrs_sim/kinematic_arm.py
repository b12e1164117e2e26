"""The arm without dynamics, always exactly on its reference, for the many runs in which dynamics do not matter."""

from __future__ import annotations

import numpy as np

from pcmrs.devices.motion.follower import Follower, brake_limits
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.motion.reference import SetPoint
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.cell_state import CellState
from pcmrs_sim.contact import SpringContact
from pcmrs_sim.disturbance import Disturbance
from pcmrs_sim.force import TrueForce
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import SimSettings

CONTACT_STEPS = 10
"""Steps between updates of the contact: the tool moves at most 2 mm in that time."""
STANDING_STEPS = 1000
"""Steps between updates of the body's pose while the arm stands."""


class KinematicArm(Follower):
    """Replacement of `pcmrs_sim.arm.Arm` with the same references, brakes and force guard, but without dynamics.

    Args:
        facts: Nominal geometry and limits of the arm. The true ones differ by the geometry error.
        settings: Imperfections of the arm, and the seed of its errors.
        force: Limit of the force on the tool, and the relief from it.
        phantom: The body in front of the arm, and the tool for it.

    Attributes:
        cell: The model of the cell with this arm.
        contact: Contact between tool and body.
        sensor: The true force on the flange.
        disturbance: Disturbances from outside.
    """

    def __init__(self, facts: ArmFacts, settings: SimSettings, force: ForceSettings, phantom: Phantom) -> None:
        own = settings.arm
        self.sensor = TrueForce(settings.geometry.flange_from_tool_tip.transform.rotation[:, 2])
        home = np.array(own.home or facts.home)
        limits = brake_limits(facts, own.brake_acceleration, own.brake_jerk)
        super().__init__(ArmModel(facts), limits, force, self.sensor, home, STEP)
        self.cell = CellState(facts, settings, phantom)
        self.contact = SpringContact(phantom, settings.contact.stiffness)
        self.disturbance = Disturbance(len(home))
        self._sample = np.stack((home, np.zeros_like(home), np.zeros_like(home)))
        self._observed_sample: Floats | None = None
        self._last_inputs: tuple[SetPoint, Transform, float] | None = None

    def step(self, steps: int) -> None:
        """Advance by a number of steps of `STEP`; return at once if the arm stands and nothing has changed."""
        while steps > 0:
            inputs = (self.reference, self.contact.world_from_image, self.disturbance.push)
            undisturbed = self.disturbance.inactive
            if self.reference.ended and undisturbed and inputs == self._last_inputs:
                return
            self._last_inputs = inputs
            self._update_force()
            self.supervise()
            batch = min(steps, CONTACT_STEPS)
            for _ in range(batch):
                sample = self.advance()
                self._sample = sample if undisturbed else self.disturbance.apply_offset(sample)
            steps -= batch

    def track(self, reference: SetPoint) -> None:
        """Follow a given reference. The arm must be at rest."""
        self._begin(reference)

    @property
    def stride(self) -> int:
        """Largest number of steps between updates of the body's pose."""
        return STANDING_STEPS if self.reference.ended else CONTACT_STEPS

    @property
    def at_rest(self) -> bool:
        """True if the reference has ended."""
        return self.reference.ended

    @property
    def positions(self) -> Floats:
        """Joint positions, rad, (n,)."""
        position: Floats = self._sample[0]
        return position

    @property
    def velocities(self) -> Floats:
        """Joint velocities, rad/s, (n,)."""
        velocity: Floats = self._sample[1]
        return velocity

    @property
    def torques(self) -> Floats:
        """Joint torques, N m, (n,): zero, because there are no dynamics."""
        return np.zeros_like(self.positions)

    def observe(self) -> CellState:
        """Return the model of the cell with the arm in its present posture."""
        if self._sample is not self._observed_sample:
            self._observed_sample = self._sample
            self.cell.move_joints(self.positions)
        return self.cell

    def base_from_flange(self) -> Transform:
        """Return the true pose of the flange; the same object as long as the arm stands still."""
        return self.observe().pose("world_from_flange")

    def _update_force(self) -> None:
        self.contact.update(self.observe().pose("world_from_tool_tip"))
        self.sensor.update(self.contact.force + self.disturbance.push)
