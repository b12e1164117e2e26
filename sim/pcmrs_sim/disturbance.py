"""What disturbs the arm from outside its controller: a push on the tool, a joint that goes beside."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from pcmrs.spatial import Floats
from pcmrs_sim.plant import STEP

GROWTH = 0.5
"""Speed with which a joint goes beside, rad/s."""


class Disturbance:
    """Nothing, until somebody sets it.

    Args:
        joints: Of the arm.

    Attributes:
        push: Force on the tool along its +z, N.
        offset: By which the arm misses what is commanded, rad, (n,).
    """

    def __init__(self, joints: int) -> None:
        self._shift = np.zeros((3, joints))
        self.push = 0.0
        self.offset = np.zeros(joints)

    @property
    def none(self) -> bool:
        """Whether nothing is set, and nothing of what was set is left."""
        return not (self.push or any(self.offset.tolist()) or any(self._shift[0].tolist()))

    def shifted(self, sample: Floats) -> Floats:
        """What the controller takes for wanted, where `sample` is commanded, (3, n)."""
        missing = self.offset - self._shift[0]
        if missing.any():
            self._shift[0] += np.clip(missing, -GROWTH * STEP, GROWTH * STEP)
        return sample + self._shift if self._shift[0].any() else sample


class PlantDisturbance(Disturbance):
    """The same, with a push that the physics feels.

    Args:
        plant: The model, with a body ``tool``.
    """

    def __init__(self, plant: Any) -> None:
        super().__init__(plant.nv)
        self._plant = plant
        self._tool = plant.body("tool").id

    def apply(self, data: Any) -> float:
        """Sets the push for the next step of the physics; the force, N."""
        data.qfrc_applied[:] = 0.0
        if self.push:
            force = self.push * data.xmat[self._tool, 2::3]
            place = data.xpos[self._tool]
            mujoco.mj_applyFT(self._plant, data, force, np.zeros(3), place, self._tool, data.qfrc_applied)
        return self.push
