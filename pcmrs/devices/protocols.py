"""What a device is, to the operations that use it and to the driver that provides it.

A driver implements these protocols in a device node. The daemon's operations see the same protocols
through proxies over the bus, so an operation cannot tell a simulated device from a real one.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any, Protocol

from pcmrs.clock import Clock
from pcmrs.messages import BodyPose, JointState, JointTrajectory, LandmarkPrompt, MotionResult, SceneTruth


class Robot(Protocol):
    """An arm that follows joint trajectories and can always be held.

    Every method raises `DeviceError` when the robot answers with a failure and `UnknownOutcomeError`
    when it does not answer.
    """

    async def connect(self) -> JointState:
        """Returns once the robot has answered, with its measured joints."""

    async def disconnect(self) -> None:
        """Ends the connection; the robot holds its posture."""

    async def joints(self) -> JointState:
        """The newest measured joints."""

    async def follow(self, trajectory: JointTrajectory) -> MotionResult:
        """Moves along the trajectory and returns when it stands still at its end or was held."""

    async def hold(self) -> JointState:
        """Brakes at once, ends a running `follow` as ``stopped``, returns the joints at rest."""


class Pointer(Protocol):
    """A tracked stylus in a person's hand."""

    async def touch(self, prompt: LandmarkPrompt) -> None:
        """Asks for a landmark and returns once the person holds the tip on it."""

    async def release(self) -> None:
        """The person may take the pointer away."""


class Scene(Protocol):
    """A simulated scene: its ground truth and its faults. Only simulations have one."""

    async def truth(self) -> SceneTruth:
        """Poses without any measurement error, at this moment."""

    async def reseed(self, seed: int) -> None:
        """Draws all simulated errors anew from `seed`."""

    async def displace_touch(self, index: int, offset_in_image: tuple[float, float, float]) -> None:
        """The next touch of landmark `index` is off by `offset_in_image` (m)."""

    async def occlude(self, body: str, hidden: bool) -> None:
        """Hides a tracked body from the tracker, or shows it again."""

    async def move_body(self, offset_in_tracker: tuple[float, float, float]) -> None:
        """Moves the patient's body with its reference by `offset_in_tracker` (m)."""

    async def cut_robot(self, cut: bool) -> None:
        """Cuts the robot's link, or restores it; a cut arm holds its posture and does not answer."""


class RobotDriver(Robot, Protocol):
    """A robot as its node has it: the protocol plus a stream of states."""

    def states(self) -> AsyncIterator[JointState]:
        """Measured joints at the driver's own rate while connected or not."""


class TrackerDriver(Protocol):
    """An optical tracker as its node has it."""

    def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        """All bodies of one tracker frame, at the tracker's rate."""


Device = RobotDriver | TrackerDriver | Pointer | Scene


class OpenDriver(Protocol):
    """What an entry point of the group ``pcmrs.drivers`` names: opens the asked devices together."""

    def __call__(
        self, devices: Collection[str], settings: Mapping[str, Any], clock: Clock
    ) -> AbstractAsyncContextManager[Mapping[str, Any]]:
        """Opens the devices named (``robot``, ``tracker``, ``pointer``, ``scene``); closes them on exit.

        Args:
            devices: Which devices this node serves with this driver.
            settings: The whole configuration as plain data; a driver reads its own table.
            clock: The cell's clock.
        """
