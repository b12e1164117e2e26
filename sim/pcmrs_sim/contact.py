"""Contact between the tool's face and the body: a spring, and a damper if the arm has dynamics."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from pcmrs.spatial import Transform
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.settings import SkinSettings

LARGEST_DAMPING = 1.0
"""Largest force of the damper, as a fraction of the spring's force, at any speed of the body."""


class Contact:
    """Contact of a tool with dynamics. It pushes the tool along its +z with ``k d (1 + c d')``.

    Here d is the depth of the body beyond the tool's face. Because the damping grows with depth, the force starts at
    zero, even in an impact (Hunt, Crossley, Coefficient of Restitution Interpreted as Damping in Vibroimpact, J. Appl.
    Mech. 1975). There is no friction.

    Args:
        plant: The arm as an ``mujoco.MjModel``, with a body ``tool``.
        phantom: The body, its pose, and the radius of the tool's face.
        settings: Spring and damper.
        step: Time between calls of `apply`, s.

    Attributes:
        force: Force on the tool along its +z, N.
    """

    def __init__(self, plant: Any, phantom: Phantom, settings: SkinSettings, step: float) -> None:
        self._tool = plant.body("tool").id
        self._solid = phantom.solid
        self._radius = phantom.tool_radius
        self._settings = settings
        self._step = step
        self._touch_distance_squared = (phantom.solid.bounding_radius + phantom.tool_radius) ** 2
        self._face = np.zeros((2, 3))  # offset of its centre from the body's origin, and its axis, in the world frame
        self._depth = 0.0
        self.force = 0.0
        self.place(phantom.world_from_image)

    def place(self, world_from_image: Transform) -> None:
        """Set the pose of the body."""
        self._world_from_image = world_from_image
        self._centre = (world_from_image @ self._solid.centre).tolist()

    def apply(self, data: Any) -> None:
        """Set the external force on the tool for the next step of the physics.

        Args:
            data: State of the plant, an ``mujoco.MjData``.
        """
        if not self.clear(data):
            self._touch(data)
        elif self._depth:
            self._release(data)

    def clear(self, data: Any) -> bool:
        """Return true if the tool is too far from the body to touch it.

        Args:
            data: State of the plant, an ``mujoco.MjData``.
        """
        x, y, z = data.xpos[self._tool].tolist()
        a, b, c = self._centre
        return bool((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 >= self._touch_distance_squared)

    def _touch(self, data: Any) -> None:
        pose, face, tool = self._world_from_image, self._face, self._tool
        face[0] = data.xpos[tool] - pose.translation
        face[1] = data.xmat[tool, 2::3]
        origin_in_image, axis_in_image = face @ pose.rotation
        touch = self._solid.touch(origin_in_image, axis_in_image, self._radius)
        if touch is None:
            self._release(data)
            return
        rate = (touch.depth - self._depth) / self._step
        damping = min(LARGEST_DAMPING, max(-LARGEST_DAMPING, self._settings.damping * rate))
        self._depth = touch.depth
        self.force = self._settings.stiffness * touch.depth * (1.0 + damping)
        wrench = data.xfrc_applied[tool]
        wrench[:3] = self.force * face[1]
        # MuJoCo applies the external force at the centre of mass, so the moment of the true contact point is added.
        lever = pose.rotation @ touch.point + pose.translation - data.xipos[tool]
        mujoco.mju_cross(wrench[3:], lever, wrench[:3])

    def _release(self, data: Any) -> None:
        self._depth = self.force = 0.0
        data.xfrc_applied[self._tool] = 0.0


class SpringContact:
    """Contact of a tool without dynamics. It pushes the tool along its +z with ``k d``.

    Here d is the depth of the body beyond the tool's face. The motion of the tool is prescribed, so that there is no
    impact that a damper could soften.

    Args:
        phantom: The body, its pose, and the radius of the tool's face.
        stiffness: k, N/m.

    Attributes:
        force: Force on the tool along its +z, N.
        world_from_image: Pose of the body.
    """

    def __init__(self, phantom: Phantom, stiffness: float) -> None:
        self._solid = phantom.solid
        self._radius = phantom.tool_radius
        self._stiffness = stiffness
        self._touch_distance_squared = (phantom.solid.bounding_radius + phantom.tool_radius) ** 2
        self.force = 0.0
        self.place(phantom.world_from_image)

    def place(self, world_from_image: Transform) -> None:
        """Set the pose of the body."""
        self.world_from_image = world_from_image
        self._centre = (world_from_image @ self._solid.centre).tolist()

    def update(self, world_from_tool: Transform) -> None:
        """Update the force from the pose of the tool."""
        x, y, z = world_from_tool.translation.tolist()
        a, b, c = self._centre
        self.force = 0.0
        if (x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 < self._touch_distance_squared:
            pose = self.world_from_image
            origin_in_image = (world_from_tool.translation - pose.translation) @ pose.rotation
            axis_in_image = world_from_tool.rotation[:, 2] @ pose.rotation
            touch = self._solid.touch(origin_in_image, axis_in_image, self._radius)
            self.force = 0.0 if touch is None else self._stiffness * touch.depth
