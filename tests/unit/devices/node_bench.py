"""A device node with fakes of its devices, and the daemon's side of it, in simulated time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import msgspec

from pcmrs.devices.deadman import DEADMAN, beat_period
from pcmrs.devices.node import DAEMON_BEAT, DeviceNode
from pcmrs.devices.remote import RemotePointer, RemoteRobot, RemoteScene
from pcmrs.messages import (
    Beat,
    DeviceReply,
    DeviceRequest,
    JointTrajectory,
)
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.testing.devices import STATE, FakeHand, FakeRobot, FakeTracker
from pcmrs.threads import Load
from tests.support.memory_link import MemoryLink

BEAT_PERIOD = beat_period(DEADMAN)

TRAJECTORY = JointTrajectory(period=0.005, positions=[[0.0] * 7, [0.1] * 7])


class FakeScheduling:
    """A machine that serves the node, unless told otherwise."""

    def __init__(self) -> None:
        self.waits = 0.0
        self.busy = False

    def waited(self) -> float:
        return self.waits

    def pending(self) -> bool:
        return self.busy

    def load(self) -> Load:
        return Load(running=9, processors=2)


class Bench:
    serving: asyncio.Task[None]

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.link = MemoryLink()
        self.robot_device, self.tracker, self.hand = FakeRobot(), FakeTracker(), FakeHand()
        devices = {"robot": self.robot_device, "tracker": self.tracker, "pointer": self.hand, "scene": self.hand}
        self.scheduling = FakeScheduling()
        self.node = DeviceNode(self.link, devices, self.clock, DEADMAN, self.scheduling)
        self.robot = RemoteRobot(self.link, self.clock, "a")
        self.pointer = RemotePointer(self.link, self.clock, 30.0, "a")
        self.scene = RemoteScene(self.link, self.clock)

    async def raw(self, device: str, method: str, **arguments: Any) -> DeviceReply:
        request = DeviceRequest(method=method, arguments=arguments, token=self.robot.token())
        return await self.link.request(f"dev/{device}/cmd", request, DeviceReply, 1.0)


@asynccontextmanager
async def open_bench() -> AsyncIterator[Bench]:
    bench = Bench()
    bench.serving = serving = asyncio.create_task(bench.node.run())
    await settle()
    await bench.robot.joints()
    await bench.robot.release_latch()
    yield bench
    serving.cancel()
    with suppress(asyncio.CancelledError):
        await serving


MOVING = msgspec.structs.replace(STATE, moving=True)


def beat(bench: Bench, number: int, delay: float = 0.0, *, age: float = 0.0, session: str = "a") -> None:
    """The daemon's heartbeat arrives, `delay` s after it was sent; its sign of life was `age` s old then."""
    sent = bench.clock.monotonic() - delay
    bench.link.hear(DAEMON_BEAT, Beat(number=number, session=session, alive=sent - age, sent=sent))


async def beat_for(bench: Bench, seconds: float, first: int = 1, delay: float = 0.0, session: str = "a") -> int:
    """Heartbeats as a daemon sends them; returns the next number."""
    numbers = range(first, first + round(seconds / BEAT_PERIOD))
    for number in numbers:
        beat(bench, number, delay, session=session)
        await bench.clock.advance(BEAT_PERIOD)
    return numbers.stop
