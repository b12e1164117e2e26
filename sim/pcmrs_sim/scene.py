"""Ground truth and faults of the simulated scene, for experiments and tests."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from pcmrs.errors import DeviceError
from pcmrs.messages import HeadMotion, SceneTruth
from pcmrs.spatial import Transform
from pcmrs_sim.arm import Arm
from pcmrs_sim.kinematic_arm import KinematicArm
from pcmrs_sim.motion import check_motion
from pcmrs_sim.pointer import SimPointer
from pcmrs_sim.settings import Triple
from pcmrs_sim.tracker_faults import BODIES
from pcmrs_sim.world import World


class SimScene:
    """Truth and acts that only a simulation has; implements `pcmrs.devices.protocols.Scene`.

    Args:
        world: True state of the cell.
        pointer: The pointer, whose touches can be displaced.
        inject: Injects or ends a fault of `pcmrs_sim.faults`, by name and arguments.
        watched: Returns a context in which a watcher is called each time after time has passed.

    Attributes:
        watched: Returns a context in which a watcher is called each time after time has passed.
    """

    def __init__(
        self,
        world: World,
        pointer: SimPointer,
        inject: Callable[[str, dict[str, Any]], None],
        watched: Callable[[Callable[[], None]], AbstractContextManager[None]],
    ) -> None:
        self.watched = watched
        self._world = world
        self._pointer = pointer
        self._inject = inject

    @property
    def arm(self) -> Arm | KinematicArm:
        """The simulated arm, with its true state."""
        return self._world.arm

    @property
    def tool(self) -> Transform:
        """True pose of the tool in the tracker frame; its +z points away from the body."""
        return self._world.tracker_from_tool_tip()

    def is_near_body(self, within: float) -> bool:
        """Return whether the body is in front of the face of the tool, within a distance, m."""
        return self._world.is_near_body(within)

    async def truth(self) -> SceneTruth:
        return self._world.truth()

    async def reseed(self, seed: int) -> None:
        self._world.reseed(seed)

    async def displace_touch(self, index: int, offset_in_image: tuple[float, float, float]) -> None:
        self._pointer.displace(index, np.array(offset_in_image))

    async def occlude(self, body: str, hidden: bool) -> None:
        if body not in BODIES:
            raise DeviceError(f"The tracker does not track {body!r}; it tracks {', '.join(BODIES)}.", body=body)
        if hidden:
            self._world.hidden.add(body)
        else:
            self._world.hidden.discard(body)

    async def move_body(self, offset_in_tracker: tuple[float, float, float]) -> None:
        self._world.shift_body(np.array(offset_in_tracker))

    async def set_motion(self, motion: HeadMotion) -> None:
        check_motion(motion)
        self._world.set_motion(motion)

    async def bump_reference(self, offset_in_body_ref: Triple, rotvec: Triple) -> None:
        self._world.bump_reference(Transform.from_rotvec(offset_in_body_ref, rotvec))

    async def pivot_pointer(self, duration: float) -> None:
        self._pointer.pivot(duration)

    async def cut_robot(self, cut: bool) -> None:
        self._inject("cut_robot", {"on": cut})

    async def inject(self, fault: str, arguments: dict[str, Any]) -> None:
        self._inject(fault, arguments)
