"""The person with the digitizing pointer."""

from __future__ import annotations

import numpy as np

from pcmrs.clock import Clock
from pcmrs.errors import DeviceError
from pcmrs.messages import LandmarkPrompt
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.motion import Pivot
from pcmrs_sim.phantoms import SURFACE_POINTS
from pcmrs_sim.shape import rotation_with_z
from pcmrs_sim.world import World


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
        self._released = 0

    async def touch(self, prompt: LandmarkPrompt) -> None:
        await self._reach()
        error = self._world.touch_errors.next(prompt.index)
        slip = self._displacements.pop(prompt.index, np.zeros(3))
        await self._rest(np.array(prompt.position_in_image) + error + slip)

    async def touch_surface(self) -> None:
        await self._reach()
        settings, rng = self._world.settings, self._world.touch_errors.surface
        beside = rng.normal(0.0, settings.digitization.surface_noise_mm * 1e-3, 3)
        await self._rest(SURFACE_POINTS[settings.phantom](rng) + beside)

    async def release(self) -> None:
        self._released += 1
        self._world.image_from_pointer = self._world.pivot = None

    def pivot(self, duration: float) -> None:
        """Turns the pointer about its tip in a divot, where the first landmark is planned, for `duration` s."""
        time, divot = self._world.time, self._world.phantom.landmarks[0].position
        self._world.pivot = Pivot(time, time + duration, self._image_from_tip(divot), self._tip_from_pointer)

    def displace(self, index: int, offset_in_image: Floats) -> None:
        """Adds an error, m, (3,), to the next touch of landmark `index` only."""
        self._displacements[index] = offset_in_image

    async def _reach(self) -> None:
        """Goes there. Raises `DeviceError` if the hand was released on its way: then it does not go on."""
        released = self._released
        self._world.image_from_pointer = self._world.pivot = None
        await self._clock.sleep(self._world.settings.digitization.reach_time)
        if self._released != released:
            raise DeviceError("The pointer was released before it was there. Ask for the touch again.")

    async def _rest(self, tip_in_image: Floats) -> None:
        self._world.image_from_pointer = self._image_from_tip(tip_in_image) @ self._tip_from_pointer
        await self._clock.sleep(self._world.settings.digitization.rest_time)

    @property
    def _tip_from_pointer(self) -> Transform:
        return self._world.settings.geometry.pointer_from_tip.transform.inverse()

    def _image_from_tip(self, tip_in_image: Floats) -> Transform:
        """A tip that is there, with the shaft along +z, away from the body."""
        return Transform(rotation_with_z(tip_in_image - self._world.phantom.inside), tip_in_image)
