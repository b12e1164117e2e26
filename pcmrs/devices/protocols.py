"""What a device is, to the operations that use it and to the driver that provides it.

A driver implements these protocols in a device node. The daemon's operations see the same protocols
through proxies over the bus, so an operation cannot tell a simulated device from a real one.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any, Protocol

import numpy.typing as npt

from pcmrs.clock import Clock
from pcmrs.messages import (
    BodyPose,
    DeviceEvent,
    Epoch,
    FiredPulse,
    HeadMotion,
    JointSetpoint,
    JointState,
    JointTrajectory,
    LandmarkPrompt,
    MotionResult,
    PressRequest,
    SceneTruth,
    ServoSession,
    StimulatorState,
)


class ServoStream(Protocol):
    """A running servo session, as who sends the set points has it."""

    def send(self, positions: npt.ArrayLike, velocities: npt.ArrayLike) -> None:
        """Sends where the joints shall be now (rad) and how fast they shall go there (rad/s), (n,); never waits.

        The robot extrapolates it until the next one comes, and brakes when none does.
        """


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

    async def press(self, request: PressRequest) -> MotionResult:
        """Goes along an axis of the tool until it presses as asked, and stays there.

        Returns:
            ``done`` once the force was within 0.3 N of the asked one for 0.5 s; ``stopped`` with reason
            ``no_contact`` or ``travel_limit`` at the end of the travel, ``joint_limit``, ``timeout``, ``held`` or
            ``force_limit``.
        """

    async def begin_servo(self) -> ServoSession:
        """Opens a session of set points; the robot stands still until the first one comes."""

    async def end_servo(self, session: int) -> MotionResult:
        """Ends this session, never a later one, and returns when the robot stands.

        Returns:
            ``stopped`` with the reason if the robot had ended it by itself before.
        """

    def servo(self) -> AbstractAsyncContextManager[ServoStream]:
        """A servo session for as long as the context lasts; leaving it returns when the robot stands."""

    async def hold(self) -> JointState:
        """Brakes at once, ends what runs as ``stopped``, returns the joints at rest."""


class Pointer(Protocol):
    """A tracked stylus in a person's hand."""

    async def touch(self, prompt: LandmarkPrompt) -> None:
        """Asks for a landmark and returns once the person holds the tip on it."""

    async def touch_surface(self) -> None:
        """Asks for any point of the skin and returns once the person holds the tip on it."""

    async def release(self) -> None:
        """The person may take the pointer away."""


class Stimulator(Protocol):
    """A magnetic stimulator with its coil.

    Every method raises `DeviceError` when it refuses and `UnknownOutcomeError` when it does not answer.
    """

    async def state(self) -> StimulatorState:
        """What it says of itself now."""

    async def set_intensity(self, percent: float) -> StimulatorState:
        """Sets the intensity, percent of its maximum output, 0 to 100."""

    async def arm(self) -> StimulatorState:
        """Charges it; returns when it is ready to fire. It disarms by itself after some time without a pulse."""

    async def disarm(self) -> StimulatorState:
        """Makes it unable to fire; takes effect at once, also while it charges."""

    async def fire(self, number: int) -> FiredPulse:
        """Gives one pulse.

        Args:
            number: Of the pulse; one that is not greater than the last is refused, so that a repeat gives none.
        """


class Latching(Protocol):
    """A device that Stop latches, as the daemon has it; see `pcmrs.devices.gate`.

    Attributes:
        name: Of the device.
    """

    name: str

    @property
    def latched(self) -> bool:
        """Whether it is latched, by its newest report; True until there is one."""

    async def stop(self) -> object:
        """Ends whatever acts and latches the device; returns when that is confirmed.

        Raises:
            DeviceError: The device answered with a failure.
            UnknownOutcomeError: It has not confirmed that in time.
        """

    async def release_latch(self) -> None:
        """Ends the latch, unless the device was stopped once more, or restarted, since it was last heard.

        Raises:
            DeviceError: It was; or it has not been heard yet.
            UnknownOutcomeError: It does not answer.
        """


class LatchingRobot(Robot, Latching, Protocol):
    """A robot as the daemon has it."""


class LatchingStimulator(Stimulator, Latching, Protocol):
    """A stimulator as the daemon has it."""


class Emg(Protocol):
    """An electromyograph that knows the stimulator's pulses."""

    async def epoch(self, pulse: int, before: float, after: float) -> Epoch:
        """The signal around a pulse, from `before` s before it until `after` s after it.

        Waits until it has been measured, `after` and half a second at most.

        Raises:
            DeviceError: The pulse's marker was not seen, or the signal has stopped.
        """


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

    async def set_motion(self, motion: HeadMotion) -> None:
        """The patient's body moves like that from now on, with its reference."""

    async def bump_reference(
        self, offset_in_body_ref: tuple[float, float, float], rotvec: tuple[float, float, float]
    ) -> None:
        """Moves the reference on the body by an offset (m) and a rotation vector (rad), both in its own axes.

        The body and the tracked body ``witness``, fixed to it elsewhere, stay.
        """

    async def pivot_pointer(self, duration: float) -> None:
        """The pointer pivots about its tip in a divot of the body for `duration` s of the cell, then goes away."""

    async def cut_robot(self, cut: bool) -> None:
        """Cuts the robot's link, or restores it; a cut arm holds its posture and does not answer."""

    async def inject(self, fault: str, arguments: dict[str, Any]) -> None:
        """Brings about a fault of the catalogue, or ends it; `pcmrs-sim faults` lists them."""


class RobotDriver(Robot, Protocol):
    """A robot as its node has it: the protocol plus streams of states and events, and set points without answer."""

    @property
    def trouble(self) -> str:
        """Why it sends no states, and what to do; empty while it does."""

    @property
    def dropped(self) -> int:
        """Set points that were repeated, stale or of no running session."""

    def states(self) -> AsyncIterator[JointState]:
        """Measured joints at the driver's own rate while connected or not."""

    def events(self) -> AsyncIterator[DeviceEvent]:
        """What the robot has to report by itself."""

    def set_point(self, setpoint: JointSetpoint) -> None:
        """Takes a set point of the running session; one that is stale or foreign is dropped, never an error."""


class StimulatorDriver(Stimulator, Protocol):
    """A stimulator as its node has it: the protocol plus a stream of events."""

    def events(self) -> AsyncIterator[DeviceEvent]:
        """What it has to report by itself: ``disarmed`` whenever it was armed and is no more, unasked."""


class TrackerDriver(Protocol):
    """An optical tracker as its node has it."""

    @property
    def trouble(self) -> str:
        """Why it sends no frames, and what to do; empty while it does."""

    def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        """All bodies of one tracker frame, at the tracker's rate."""


Device = RobotDriver | TrackerDriver | Pointer | Scene | StimulatorDriver | Emg


class OpenDriver(Protocol):
    """What an entry point of the group ``pcmrs.drivers`` names: opens the asked devices together."""

    def __call__(
        self, devices: Collection[str], settings: Mapping[str, Any], clock: Clock
    ) -> AbstractAsyncContextManager[Mapping[str, Any]]:
        """Opens the devices named; closes them on exit.

        A driver that needs a process of its own may start it with the call already. One that has failed for good
        cancels the task that has entered the context, and raises `DeviceError`: its node ends then, and is restarted.

        Args:
            devices: Which of ``robot``, ``tracker``, ``pointer``, ``scene``, ``stimulator``, ``emg`` this node serves
                with this driver.
            settings: The whole configuration as plain data; a driver reads its own table.
            clock: The cell's clock.
        """
