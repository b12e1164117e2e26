"""The devices of a simulated world, as proxies in its node: calls and streams are messages."""

from __future__ import annotations

import asyncio
import itertools
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any

import msgspec

from pcmrs.clock import Clock
from pcmrs.devices.calls import PROTOCOLS, methods_of
from pcmrs.devices.deadman import beat_period
from pcmrs.devices.protocols import ServoStream
from pcmrs.devices.servo import servo_session
from pcmrs.devices.stream import Stream
from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import Beat, BodyPose, DeviceEvent, JointSetpoint, JointState
from pcmrs_sim.process.channel import Channel
from pcmrs_sim.process.wire import (
    Alive,
    ArmState,
    Call,
    Cancel,
    Open,
    Opened,
    Reply,
    ServoPoint,
    ToWorld,
    TrackerPoses,
    Trouble,
    WorldEvent,
    pack,
    read_by_node,
)

LOST = "The simulated cell has ended. Look at the arm before you continue."


class WorldClient:
    """The link to a world in another process.

    Args:
        link: Connected socket to that process.
        machine: The machine's clock.
        lost: Called when the world has ended by itself.

    Attributes:
        frames: Frames of the tracker.
        states: Joint states of the robot.
        events: Name of a device to its events.
        trouble: Name of a device to the reason for which it sends nothing; empty while it sends.
        dropped: Number of set points that the arm has dropped.
        is_lost: The world has ended by itself.
    """

    def __init__(self, link: socket.socket, machine: Clock, lost: Callable[[], object]) -> None:
        self.frames: Stream[Sequence[BodyPose]] = Stream()
        self.states: Stream[JointState] = Stream()
        self.events: Mapping[str, Stream[DeviceEvent]] = {"robot": Stream(), "stimulator": Stream()}
        self.trouble: dict[str, str] = {}
        self.dropped = 0
        self.is_lost = False
        self._lost, self._machine = lost, machine
        self._opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._calls: dict[int, asyncio.Future[Any]] = {}
        self._numbers = itertools.count(1)
        self._channel = Channel(link, self._receive, self._handle_end)

    async def open(self, devices: Collection[str], settings: Mapping[str, Any]) -> None:
        """Open the cell in the world; return when it runs.

        Args:
            devices: Names of the devices that the node serves.
            settings: The whole configuration.

        Raises:
            ConfigurationError: The world refuses its settings.
            UnknownOutcomeError: The world has ended.
        """
        self._send(Open(list(devices), dict(settings)))
        await self._opened

    async def beat(self, deadman: float) -> None:
        """Send heartbeats of this event loop until cancelled.

        Args:
            deadman: Silence after which the world makes its devices safe, s.
        """
        for number in itertools.count(1):
            now = self._machine.monotonic()
            beat = Beat(number=number, session="node", alive=now, sent=now)
            self._channel.send(pack(Alive(beat)), droppable=True)
            await self._machine.sleep(beat_period(deadman))

    async def call(self, device: str, method: str, arguments: Mapping[str, Any]) -> Any:
        """Call a method of a device and return its result as plain data.

        Args:
            device: Name of the device.
            method: Name of the method in its protocol.
            arguments: Arguments by name, as plain data.

        Raises:
            PcmrsError: The error that the device raises.
            UnknownOutcomeError: The world has ended.
        """
        if self.is_lost:
            raise UnknownOutcomeError(LOST)
        number = next(self._numbers)
        answer = self._calls[number] = asyncio.get_running_loop().create_future()
        self._send(Call(number, device, method, dict(arguments), self._machine.monotonic()))
        try:
            return await answer
        except asyncio.CancelledError:
            self._send(Cancel(number))
            raise
        finally:
            self._calls.pop(number, None)

    def set_point(self, setpoint: JointSetpoint) -> None:
        """Send a set point to the arm."""
        self._channel.send(pack(ServoPoint(setpoint)), droppable=True)

    def close(self) -> None:
        """Close the link, which ends the world."""
        self._channel.close()
        self._fail_pending()

    def _send(self, message: ToWorld) -> None:
        self._channel.send(pack(message))

    def _receive(self, body: bytes) -> None:
        match read_by_node(body):
            case TrackerPoses(poses):
                self.frames.publish(poses)
            case ArmState(state, dropped):
                self.dropped = dropped
                self.states.publish(state)
            case WorldEvent(event):
                self.events[event.device].publish(event)
            case Trouble(device, text):
                self.trouble[device] = text
            case Reply(number, result, failure):
                answer = self._calls.get(number)
                if answer is None or answer.done():  # its caller was cancelled
                    return
                if failure is not None:
                    answer.set_exception(failure.error())
                else:
                    answer.set_result(result)
            case Opened(failure) if not self._opened.done():
                if failure is not None:
                    self._opened.set_exception(failure.error())
                else:
                    self._opened.set_result(None)

    def _handle_end(self) -> None:
        self.is_lost = True
        self._fail_pending()
        self._lost()

    def _fail_pending(self) -> None:
        for waiting in (self._opened, *self._calls.values()):
            if not waiting.done():
                waiting.set_exception(UnknownOutcomeError(LOST))
        self.frames.close()
        self.states.close()
        for events in self.events.values():
            events.close()


class WorldDevice:
    """Proxy of a device in the world. It has the methods of the device's protocol.

    Args:
        world: World with the device.
        name: Name of the device.
    """

    def __init__(self, world: WorldClient, name: str) -> None:
        self._world, self._name = world, name

    def __getattr__(self, method: str) -> Callable[..., Awaitable[Any]]:
        hints = methods_of(self._name).get(method)
        if hints is None:
            raise AttributeError(f"A {self._name} has no method {method!r}.")
        names = [name for name in hints if name != "return"]

        async def call(*values: Any, **arguments: Any) -> Any:
            given = dict(zip(names, values, strict=False)) | arguments
            return msgspec.convert(await self._world.call(self._name, method, given), hints["return"])

        return call


class WorldRobot(WorldDevice):
    """Proxy of the arm; implements `pcmrs.devices.protocols.RobotDriver`.

    Args:
        world: World with the arm.
        clock: The cell's clock, which stamps set points.
    """

    def __init__(self, world: WorldClient, clock: Clock) -> None:
        super().__init__(world, "robot")
        self._clock = clock

    @property
    def trouble(self) -> str:
        return self._world.trouble.get("robot", "")

    @property
    def dropped(self) -> int:
        return self._world.dropped

    def states(self) -> AsyncIterator[JointState]:
        return self._world.states.read()

    def events(self) -> AsyncIterator[DeviceEvent]:
        return self._world.events["robot"].read()

    def set_point(self, setpoint: JointSetpoint) -> None:
        self._world.set_point(setpoint)

    def servo(self) -> AbstractAsyncContextManager[ServoStream]:
        return servo_session(self, self.set_point, self._clock)  # type: ignore[arg-type]


class WorldStimulator(WorldDevice):
    """Proxy of the stimulator; implements `pcmrs.devices.protocols.StimulatorDriver`."""

    def events(self) -> AsyncIterator[DeviceEvent]:
        return self._world.events["stimulator"].read()


class WorldTracker:
    """Proxy of the tracker; implements `pcmrs.devices.protocols.TrackerDriver`.

    Args:
        world: World with the tracker.
    """

    def __init__(self, world: WorldClient) -> None:
        self._world = world

    @property
    def trouble(self) -> str:
        return self._world.trouble.get("tracker", "")

    def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        return self._world.frames.read()


def devices_of(world: WorldClient, names: Collection[str], clock: Clock) -> Mapping[str, Any]:
    """Return proxies of devices in a world.

    Args:
        world: The opened world.
        names: Names of the devices.
        clock: The cell's clock.

    Returns:
        Name of each device to its proxy.
    """
    special = {
        "robot": WorldRobot(world, clock),
        "stimulator": WorldStimulator(world, "stimulator"),
        "tracker": WorldTracker(world),
    }
    others = {name: WorldDevice(world, name) for name in PROTOCOLS if name not in special}
    return {name: (special | others)[name] for name in names}
