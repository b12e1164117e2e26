"""Protocols of the devices, for the operations that use them and the drivers that provide them.

A driver implements these protocols in a device node. The daemon's operations use the same protocols through proxies
over the bus, so an operation cannot distinguish a simulated device from a real one.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection, Iterable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any, Protocol, runtime_checkable

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

__all__ = [
    "Device",
    "Emg",
    "Latching",
    "LatchingRobot",
    "LatchingStimulator",
    "OpenDriver",
    "Pointer",
    "Robot",
    "RobotDriver",
    "Scene",
    "ServoStream",
    "Stimulator",
    "StimulatorDriver",
    "TrackerDriver",
]


class ServoStream(Protocol):
    """A running servo session, from the side that sends the set points."""

    def send(self, positions: Iterable[float], velocities: Iterable[float]) -> None:
        """Send a set point; never waits. The robot extrapolates it until the next one, and brakes if none arrives.

        Args:
            positions: Joint positions at this moment, base to flange, rad, (n,).
            velocities: Joint velocities at this moment, rad/s, (n,).
        """


class Robot(Protocol):
    """An arm that follows joint trajectories and can always be held, some only at the end of a short segment.

    Every method raises `DeviceError` if the robot answers with a failure and `UnknownOutcomeError` if it does not
    answer.
    """

    async def connect(self) -> JointState:
        """Connect, and return the measured joints once the robot has answered."""

    async def disconnect(self) -> None:
        """End the connection; the robot holds its posture."""

    async def joints(self) -> JointState:
        """Return the measured joints. A robot that has gone silent is an error; it does not return its last joints."""

    async def follow(self, trajectory: JointTrajectory) -> MotionResult:
        """Move along a trajectory, and return when the arm is at rest at its end or was held."""

    async def press(self, request: PressRequest) -> MotionResult:
        """Move along an axis of the tool until it presses with the requested force, and stay there.

        Returns:
            ``done`` once the force was within 0.3 N of the requested one for 0.5 s; ``stopped`` with reason
            ``no_contact`` or ``travel_limit`` at the end of the travel, ``joint_limit``, ``timeout``, ``held`` or
            ``force_limit``.
        """

    async def begin_servo(self) -> ServoSession:
        """Open a session of set points; the robot stands still until the first one arrives."""

    async def end_servo(self, session: int) -> MotionResult:
        """End this session, never a later one, and return when the robot stands.

        Returns:
            ``done``; ``stopped`` with the reason if the robot had ended the session by itself before.
        """

    def servo(self) -> AbstractAsyncContextManager[ServoStream]:
        """Return a context with a servo session; leaving it waits until the robot stands."""

    async def hold(self) -> JointState:
        """Brake at once, end the running motion as ``stopped``, and return the joints at rest."""


class Pointer(Protocol):
    """A tracked stylus in a person's hand."""

    async def touch(self, prompt: LandmarkPrompt) -> None:
        """Prompt for a landmark, and return once the person holds the tip on it."""

    async def touch_surface(self) -> None:
        """Prompt for any point of the skin, and return once the person holds the tip on it."""

    async def slide(self) -> None:
        """Prompt to slide the tip over the skin until `release`, and return once the person holds it there."""

    async def release(self) -> None:
        """End the prompt: the person may take the pointer away."""


class Stimulator(Protocol):
    """A magnetic stimulator with its coil.

    Every method raises `DeviceError` if the stimulator refuses and `UnknownOutcomeError` if it does not answer.
    """

    async def state(self) -> StimulatorState:
        """Return the present state."""

    async def set_intensity(self, percent: float) -> StimulatorState:
        """Set the intensity, percent of the maximum output, 0 to 100."""

    async def arm(self) -> StimulatorState:
        """Charge, and return when it is ready to fire. It disarms by itself after some time without a pulse."""

    async def disarm(self) -> StimulatorState:
        """Disarm at once, also while it charges."""

    async def fire(self, number: int) -> FiredPulse:
        """Give one pulse.

        Args:
            number: Number of the pulse. One that is not higher than the last is refused, so that a repeated request
                gives no second pulse.
        """


class Latching(Protocol):
    """A device that Stop latches, from the daemon's side; see `pcmrs.devices.gate`.

    Attributes:
        name: Name of the device.
    """

    name: str

    @property
    def latched(self) -> bool:
        """True if the device is latched by its newest report, and until there is one."""

    async def stop(self) -> object:
        """End whatever acts, latch the device, and return when that is confirmed.

        Raises:
            DeviceError: The device answered with a failure.
            UnknownOutcomeError: The device did not confirm that in time.
        """

    async def release_latch(self) -> None:
        """End the latch, unless the device was stopped again, or restarted, since its last report.

        Raises:
            DeviceError: The device was stopped again or restarted, or there is no report yet.
            UnknownOutcomeError: The device does not answer.
        """


class LatchingRobot(Robot, Latching, Protocol):
    """A robot from the daemon's side."""


class LatchingStimulator(Stimulator, Latching, Protocol):
    """A stimulator from the daemon's side."""


class Emg(Protocol):
    """An electromyograph that knows the stimulator's pulses."""

    async def epoch(self, pulse: int, before: float, after: float) -> Epoch:
        """Return the signal around a pulse; waits until it is measured, `after` and half a second at most.

        Args:
            pulse: Number of the pulse.
            before: Duration before the pulse, s.
            after: Duration after the pulse, s.

        Raises:
            DeviceError: The marker of the pulse was not received, or the signal has stopped.
        """


class Scene(Protocol):
    """A simulated scene: its ground truth and its faults. Only simulations have one."""

    async def truth(self) -> SceneTruth:
        """Return the present poses without any measurement error."""

    async def reseed(self, seed: int) -> None:
        """Restart the random numbers of all simulated errors from `seed`."""

    async def displace_touch(self, index: int, offset_in_image: tuple[float, float, float]) -> None:
        """Displace the next touch of a landmark.

        Args:
            index: Index of the landmark in the plan, from 0.
            offset_in_image: Offset of the touch in the image frame, m.
        """

    async def occlude(self, body: str, hidden: bool) -> None:
        """Hide a tracked body from the tracker, or show it again.

        Args:
            body: Name of the tracked body.
            hidden: True to hide it.
        """

    async def move_body(self, offset_in_tracker: tuple[float, float, float]) -> None:
        """Move the patient's body with its reference by `offset_in_tracker` (m)."""

    async def set_motion(self, motion: HeadMotion) -> None:
        """Let the patient's body and its reference move like `motion` from now on."""

    async def bump_reference(
        self, offset_in_body_ref: tuple[float, float, float], rotvec: tuple[float, float, float]
    ) -> None:
        """Move the reference on the body. The body, and the tracked body ``witness`` elsewhere on it, stay.

        Args:
            offset_in_body_ref: Offset along the axes of the reference, m.
            rotvec: Rotation vector about the axes of the reference, rad.
        """

    async def pivot_pointer(self, duration: float) -> None:
        """Pivot the pointer about its tip in a divot of the body for `duration` s of the cell, then remove it."""

    async def cut_robot(self, cut: bool) -> None:
        """Cut the robot's link, or restore it; a cut arm holds its posture and does not answer."""

    async def inject(self, fault: str, arguments: dict[str, Any]) -> None:
        """Start a fault of the catalogue, or end it.

        Args:
            fault: Name of the fault; `pcmrs-sim faults` lists them.
            arguments: Arguments of the fault by name.
        """


class RobotDriver(Robot, Protocol):
    """A robot from the node's side: the protocol, streams of states and events, and set points without an answer."""

    @property
    def trouble(self) -> str:
        """Reason why it sends no states, and what to do; empty while it sends them."""

    @property
    def dropped(self) -> int:
        """Number of set points that were repeated, stale or of no running session."""

    def states(self) -> AsyncIterator[JointState]:
        """Yield the measured joints at the driver's own rate, connected or not."""

    def events(self) -> AsyncIterator[DeviceEvent]:
        """Yield what the robot reports by itself."""

    def set_point(self, setpoint: JointSetpoint) -> None:
        """Take a set point of the running session. One that is stale or of another session is dropped without error."""


class StimulatorDriver(Stimulator, Protocol):
    """A stimulator from the node's side: the protocol and a stream of events."""

    def events(self) -> AsyncIterator[DeviceEvent]:
        """Yield what it reports by itself: ``disarmed`` whenever it disarms without a request."""


class TrackerDriver(Protocol):
    """An optical tracker from the node's side."""

    @property
    def trouble(self) -> str:
        """Reason why it sends no frames, and what to do; empty while it sends them."""

    def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        """Yield all bodies of one tracker frame, at the tracker's rate."""


@runtime_checkable
class BeepingTracker(Protocol):
    """A tracker that can sound a beeper, which the person with the pointer hears."""

    def beep(self, count: int) -> None:
        """Sound beeps, 1 to 9, without waiting; nothing while the tracker is absent."""


Device = RobotDriver | TrackerDriver | Pointer | Scene | StimulatorDriver | Emg
"""Any device that a driver opens."""


class OpenDriver(Protocol):
    """Signature of an entry point of the group ``pcmrs.drivers``."""

    def __call__(
        self, devices: Collection[str], settings: Mapping[str, Any], clock: Clock
    ) -> AbstractAsyncContextManager[Mapping[str, Any]]:
        """Open devices together; leaving the context closes them.

        A driver that needs its own process may start it with this call. A driver that has failed for good cancels the
        task that entered the context, and raises `DeviceError`; its node then ends and is restarted.

        Args:
            devices: Names of the devices that this node serves with this driver: ``robot``, ``tracker``, ``pointer``,
                ``scene``, ``stimulator`` or ``emg``.
            settings: Whole configuration as plain data; a driver reads its own table.
            clock: Clock of the cell.
        """
