"""Disturbances of the arm from outside its controller: a push on the tool, and offsets of joints."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from pcmrs.spatial import Floats
from pcmrs_sim.plant import STEP

OFFSET_SPEED = 0.5
"""Speed at which a joint moves to its offset, rad/s."""


class Disturbance:
    """A push and joint offsets, both zero at the start.

    Args:
        joints: Number of joints of the arm.

    Attributes:
        push: Force on the tool along its +z, N.
        offset: Deviation of the arm from its commanded posture, rad, (n,).
    """

    def __init__(self, joints: int) -> None:
        self._present_offset = np.zeros((3, joints))
        self.push = 0.0
        self.offset = np.zeros(joints)

    @property
    def inactive(self) -> bool:
        """True if no disturbance is set, and none that was set still has an effect."""
        return not (self.push or any(self.offset.tolist()) or any(self._present_offset[0].tolist()))

    def apply_offset(self, sample: Floats) -> Floats:
        """Return the sample that the arm follows in place of a commanded one, (3, n), one `STEP` later.

        Args:
            sample: Commanded position rad, velocity rad/s and acceleration rad/s^2, (3, n).
        """
        present = self._present_offset[0]
        if not (any(self.offset.tolist()) or any(present.tolist())):  # almost always, and once per step
            return sample
        present += np.clip(self.offset - present, -OFFSET_SPEED * STEP, OFFSET_SPEED * STEP)
        return sample + self._present_offset


class PlantDisturbance(Disturbance):
    """Disturbances of an arm with dynamics, whose push is a force in the physics.

    Args:
        plant: The arm as an ``mujoco.MjModel``, with a body ``tool``.
    """

    def __init__(self, plant: Any) -> None:
        super().__init__(plant.nv)
        self._plant = plant
        self._tool = plant.body("tool").id

    def apply(self, data: Any) -> float:
        """Set the push for the next step of the physics, and return its force, N.

        Args:
            data: State of the plant, an ``mujoco.MjData``.
        """
        data.qfrc_applied[:] = 0.0
        if self.push:
            force = self.push * data.xmat[self._tool, 2::3]
            point = data.xpos[self._tool]
            mujoco.mj_applyFT(self._plant, data, force, np.zeros(3), point, self._tool, data.qfrc_applied)
        return self.push
