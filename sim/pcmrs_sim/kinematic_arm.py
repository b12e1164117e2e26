"""The arm without physics: exactly where what it follows is, for the many runs in which dynamics decide nothing."""

from __future__ import annotations

from math import sqrt

import numpy as np

from pcmrs.devices.motion.follower import Follower, brake_limits
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.motion.reference import SetPoint
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.contact_spring import SpringContact
from pcmrs_sim.disturbance import Disturbance
from pcmrs_sim.errors import displaced
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import SimSettings

LOOK_STEPS = 10
"""Steps after which contact is looked at again: the tool goes 2 mm in that time at most."""
STANDING_STEPS = 1000
"""The same while nothing moves the arm."""


class TrueForce:
    """The force on the tool as it is, without noise; see `pcmrs.devices.motion.force.FlangeForce`.

    Args:
        axis: The tool's +z, along which contact pushes, in the flange's axes, (3,).
    """

    def __init__(self, axis: Floats) -> None:
        self.axis = axis
        self._axis = axis.tolist()
        self.flange_force = (0.0, 0.0, 0.0)

    def update(self, force: float) -> None:
        """Takes the present force along the tool's +z, N."""
        i, j, k = self._axis
        self.flange_force = (force * i, force * j, force * k)

    @property
    def magnitude(self) -> float:
        """Of the force, N."""
        x, y, z = self.flange_force
        return sqrt(x * x + y * y + z * z)


class KinematicArm(Follower):
    """Takes the place of `pcmrs_sim.arm.Arm`: the same references, brakes and force guard, no dynamics.

    Args:
        facts: The arm as everybody knows it; the true one differs from it by the geometry error.
        settings: The seed of its errors.
        force: When the force on the tool is too great, and how it is relieved.
        phantom: What stands before the arm.

    Attributes:
        contact: Between tool and body.
        sensor: The force on the flange.
        disturbance: From outside.
    """

    def __init__(self, facts: ArmFacts, settings: SimSettings, force: ForceSettings, phantom: Phantom) -> None:
        own = settings.arm
        self._flange_from_tool = settings.geometry.flange_from_coil.transform
        self.sensor = TrueForce(self._flange_from_tool.rotation[:, 2])
        home = np.array(own.home or facts.home)
        limits = brake_limits(facts, own.brake_acceleration, own.brake_jerk)
        super().__init__(ArmModel(facts), limits, force, self.sensor, home, STEP)
        self._true_model = ArmModel(displaced(facts, own.geometry_error_mm * 1e-3, settings.seed))
        self.contact = SpringContact(phantom, settings.contact.stiffness)
        self.disturbance = Disturbance(len(home))
        self._sample = np.stack((home, np.zeros_like(home), np.zeros_like(home)))
        self._posture, self._base_from_flange = home, self._true_model.forward(home)
        self._placed = self._sample
        self._stood: tuple[SetPoint, Transform, float] | None = None

    def step(self, steps: int) -> None:
        """Advances by `steps` steps of `STEP` seconds; a standing arm that nothing disturbs costs one look."""
        while steps > 0:
            around = (self.reference, self.contact.world_from_image, self.disturbance.push)
            undisturbed = self.disturbance.none
            if self.reference.ended and undisturbed and around == self._stood:
                return
            self._stood = around
            self._feel()
            self.supervise()
            taken = min(steps, LOOK_STEPS)
            for _ in range(taken):
                sample = self.advance()
                self._sample = sample if undisturbed else self.disturbance.shifted(sample)
            steps -= taken

    def track(self, reference: SetPoint) -> None:
        """Takes a reference of somebody else's making; the arm must be at rest."""
        self._begin(reference)

    @property
    def stride(self) -> int:
        """So many steps of what is around it may pass at once: any number while it stands."""
        return STANDING_STEPS if self.reference.ended else LOOK_STEPS

    @property
    def at_rest(self) -> bool:
        """Whether the reference has ended."""
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
        """There are none, N m, (n,)."""
        return np.zeros_like(self.positions)

    def base_from_flange(self) -> Transform:
        """Where the flange truly is."""
        if self._sample is not self._placed:
            if not np.array_equal(self.positions, self._posture):
                self._posture = self.positions
                self._base_from_flange = self._true_model.forward(self._posture)
            self._placed = self._sample
        return self._base_from_flange

    def _feel(self) -> None:
        self.contact.update(self.base_from_flange() @ self._flange_from_tool)
        self.sensor.update(self.contact.force + self.disturbance.push)
