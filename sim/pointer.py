"""The person with the digitizing pointer."""

from __future__ import annotations

import numpy as np

from pcmrs.clock import Clock
from pcmrs.messages import LandmarkPrompt
from pcmrs.spatial import Floats, Transform
from sim.shape import rotation_with_z
from sim.world import World


class SimPointer:
    """Touches what is asked for, as well as a person can.

    Args:
        world: Where the patient is, and how wrong the plan is.
        clock: A touch takes time of this clock.
    """

    def __init__(self, world: World, clock: Clock) -> None:
        self._world = world
        self._clock = clock
        self._displacements: dict[int, Floats] = {}

    async def touch(self, prompt: LandmarkPrompt) -> None:
        settings = self._world.settings.digitization
        self._world.body_ref_from_pointer = None
        await self._clock.sleep(settings.reach_time)
        error = self._world.touch_errors.next(prompt.index)
        slip = self._displacements.pop(prompt.index, np.zeros(3))
        tip_in_image = np.array(prompt.position_in_image) + error + slip
        self._world.body_ref_from_pointer = self._body_ref_from_pointer(tip_in_image)
        await self._clock.sleep(settings.rest_time)

    async def release(self) -> None:
        self._world.body_ref_from_pointer = None

    def displace(self, index: int, offset_in_image: Floats) -> None:
        """Adds an error, m, (3,), to the next touch of landmark `index` only."""
        self._displacements[index] = offset_in_image

    def _body_ref_from_pointer(self, tip_in_image: Floats) -> Transform:
        """The marker body of a pointer whose tip is there and whose shaft points away from the body."""
        image_from_tip = Transform(rotation_with_z(tip_in_image - self._world.phantom.inside), tip_in_image)
        tip_from_pointer = self._world.settings.geometry.pointer_from_tip.transform.inverse()
        return self._world.body_ref_from_image @ image_from_tip @ tip_from_pointer
