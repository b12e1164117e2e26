"""Contact between the tool's face and the body: a spring and a damper."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from pcmrs.spatial import Transform
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.settings import SkinSettings

MOST_DAMPING = 1.0
"""The damper adds or takes so much of the spring's force at most, however fast the body is shifted."""


class Contact:
    """Pushes the tool away along its +z by ``k d (1 + c d')``, ``d`` the depth of the body beyond the tool's face.

    The damping that grows with depth makes the force begin at zero, also in an impact (Hunt, Crossley, Coefficient of
    Restitution Interpreted as Damping in Vibroimpact, J. Appl. Mech. 1975). There is no friction.

    Args:
        plant: The model, with a body ``tool``.
        phantom: The body, where it stands, and the face of its tool.
        settings: Of spring and damper.
        step: Time between calls of `apply`, s.

    Attributes:
        force: On the tool along its +z, N.
    """

    def __init__(self, plant: Any, phantom: Phantom, settings: SkinSettings, step: float) -> None:
        self._tool = plant.body("tool").id
        self._solid = phantom.solid
        self._radius = phantom.tool_radius
        self._settings = settings
        self._step = step
        self._reach_squared = (phantom.solid.reach + phantom.tool_radius) ** 2
        self._face = np.zeros((2, 3))  # its origin and axis, in the world's axes
        self._depth = 0.0
        self.force = 0.0
        self.place(phantom.world_from_image)

    def place(self, world_from_image: Transform) -> None:
        """The body is there now."""
        self._world_from_image = world_from_image
        self._centre = (world_from_image @ self._solid.centre).tolist()

    def apply(self, data: Any) -> None:
        """Sets the external force on the tool for the next step of the physics."""
        if not self.clear(data):
            self._touch(data)
        elif self._depth:
            self._release(data)

    def clear(self, data: Any) -> bool:
        """Whether the tool is too far from the body to touch it."""
        x, y, z = data.xpos[self._tool].tolist()
        a, b, c = self._centre
        return bool((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 >= self._reach_squared)

    def _touch(self, data: Any) -> None:
        place, face, tool = self._world_from_image, self._face, self._tool
        face[0] = data.xpos[tool] - place.translation
        face[1] = data.xmat[tool, 2::3]
        origin_in_image, axis_in_image = face @ place.rotation
        touch = self._solid.touch(origin_in_image, axis_in_image, self._radius)
        if touch is None:
            self._release(data)
            return
        rate = (touch.depth - self._depth) / self._step
        damping = min(MOST_DAMPING, max(-MOST_DAMPING, self._settings.damping * rate))
        self._depth = touch.depth
        self.force = self._settings.stiffness * touch.depth * (1.0 + damping)
        wrench = data.xfrc_applied[tool]
        wrench[:3] = self.force * face[1]
        # The external force acts on the centre of mass, so the moment of the place where it truly acts is added.
        arm = place.rotation @ touch.point + place.translation - data.xipos[tool]
        mujoco.mju_cross(wrench[3:], arm, wrench[:3])

    def _release(self, data: Any) -> None:
        self._depth = self.force = 0.0
        data.xfrc_applied[self._tool] = 0.0
