"""Contact of a tool whose motion is given: a spring alone, for there is no impact that a damper could soften."""

from __future__ import annotations

from pcmrs.spatial import Transform
from pcmrs_sim.phantom import Phantom


class SpringContact:
    """Pushes the tool away along its +z by ``k d``, ``d`` the depth of the body beyond the tool's face.

    Args:
        phantom: The body, where it stands, and the face of its tool.
        stiffness: k, N/m.

    Attributes:
        force: On the tool along its +z, N.
        world_from_image: Where the body is.
    """

    def __init__(self, phantom: Phantom, stiffness: float) -> None:
        self._solid = phantom.solid
        self._radius = phantom.tool_radius
        self._stiffness = stiffness
        self._touch_distance_squared = (phantom.solid.bounding_radius + phantom.tool_radius) ** 2
        self.force = 0.0
        self.place(phantom.world_from_image)

    def place(self, world_from_image: Transform) -> None:
        """The body is there now."""
        self.world_from_image = world_from_image
        self._centre = (world_from_image @ self._solid.centre).tolist()

    def update(self, world_from_tool: Transform) -> None:
        """The tool is there now."""
        x, y, z = world_from_tool.translation.tolist()
        a, b, c = self._centre
        self.force = 0.0
        if (x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 < self._touch_distance_squared:
            place = self.world_from_image
            origin = (world_from_tool.translation - place.translation) @ place.rotation
            touch = self._solid.touch(origin, world_from_tool.rotation[:, 2] @ place.rotation, self._radius)
            self.force = 0.0 if touch is None else self._stiffness * touch.depth
