"""The simulated person with the digitizing pointer."""

from __future__ import annotations

import numpy as np

from pcmrs.clock import Clock
from pcmrs.errors import DeviceError
from pcmrs.messages import LandmarkPrompt
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.motion import Pivot, Slide
from pcmrs_sim.phantoms import SURFACE_POINTS, surface_path
from pcmrs_sim.shape import rotation_with_z
from pcmrs_sim.world import World


class SimPointer:
    """`pcmrs.devices.protocols.Pointer` that touches landmarks and skin with the errors of a person.

    Args:
        world: World with the patient and the errors of touches.
        clock: Clock in whose time a touch lasts.
    """

    def __init__(self, world: World, clock: Clock) -> None:
        self._world = world
        self._clock = clock
        self._displacements: dict[int, Floats] = {}
        self._release_count = 0

    async def touch(self, prompt: LandmarkPrompt) -> None:
        await self._move_to_target()
        error = self._world.touch_errors.next(prompt.index)
        displacement = self._displacements.pop(prompt.index, np.zeros(3))
        await self._rest(np.array(prompt.position_in_image) + error + displacement)

    async def touch_surface(self) -> None:
        await self._move_to_target()
        settings, rng = self._world.settings, self._world.touch_errors.surface
        error = rng.normal(0.0, settings.digitization.surface_noise_mm * 1e-3, 3)
        await self._rest(SURFACE_POINTS[settings.phantom](rng) + error)

    async def slide(self) -> None:
        await self._move_to_target()
        settings, rng = self._world.settings, self._world.touch_errors.surface
        path = surface_path(settings.phantom, rng)
        tips = path + rng.normal(0.0, settings.digitization.surface_noise_mm * 1e-3, path.shape)
        await self._rest(tips[0])
        poses = [self._image_from_tip(tip) @ self._tip_from_pointer for tip in tips]
        self._world.pointer_motion = Slide(self._world.time, poses)

    async def release(self) -> None:
        self._release_count += 1
        self._world.image_from_pointer = self._world.pointer_motion = None

    def pivot(self, duration: float) -> None:
        """Pivot the pointer about its tip, in a divot at the planned first landmark, for a duration, s."""
        time, divot = self._world.time, self._world.phantom.landmarks[0].position
        self._world.pointer_motion = Pivot(time, time + duration, self._image_from_tip(divot), self._tip_from_pointer)

    def displace(self, index: int, offset_in_image: Floats) -> None:
        """Displace the next touch of a landmark.

        Args:
            index: Index of the landmark.
            offset_in_image: Displacement in the image, m, (3,).
        """
        self._displacements[index] = offset_in_image

    async def _move_to_target(self) -> None:
        """Wait until the hand is at its target. Raises `DeviceError` if the pointer was released meanwhile."""
        release_count = self._release_count
        self._world.image_from_pointer = self._world.pointer_motion = None
        await self._clock.sleep(self._world.settings.digitization.reach_time)
        if self._release_count != release_count:
            raise DeviceError("The pointer was released before it reached its target. Request the touch again.")

    async def _rest(self, tip_in_image: Floats) -> None:
        self._world.image_from_pointer = self._image_from_tip(tip_in_image) @ self._tip_from_pointer
        await self._clock.sleep(self._world.settings.digitization.rest_time)

    @property
    def _tip_from_pointer(self) -> Transform:
        return self._world.settings.geometry.pointer_from_tip.transform.inverse()

    def _image_from_tip(self, tip_in_image: Floats) -> Transform:
        """Return the pose of the tip at a point, with +z along the shaft, away from the body."""
        return Transform(rotation_with_z(tip_in_image - self._world.phantom.inside), tip_in_image)
