"""A robot of the KST driver at a scripted cabinet, with its events and states."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers.kst import open_devices
from pcmrs.messages import DeviceEvent, JointState, JointTrajectory
from pcmrs.spatial import Floats
from tests.unit.devices.kst_peer import Peer, served

STEP = 1 / 200


def smooth(start: Floats, goal: Floats, duration: float = 0.4) -> JointTrajectory:
    """Minimum-jerk motion, at rest at both ends."""
    time = np.linspace(0.0, 1.0, 1 + round(duration / STEP))
    way = 10 * time**3 - 15 * time**4 + 6 * time**5
    return JointTrajectory(period=STEP, positions=(start + way[:, None] * (goal - start)).tolist())


@dataclass
class Lab:
    """A robot of the driver and its cabinet."""

    robot: Any
    peer: Peer
    events: list[DeviceEvent] = field(default_factory=list)
    states: list[JointState] = field(default_factory=list)

    async def when(self, condition: Callable[[], bool]) -> None:
        """Returns once something has come about."""
        async with asyncio.timeout(5.0):
            while not condition():  # noqa: ASYNC110 - what is waited for is no business of this loop
                await asyncio.sleep(0.002)

    async def moving(self) -> None:
        """Returns in the middle of a motion."""
        before = len(self.peer.set_points())
        await self.when(lambda: len(self.peer.set_points()) > before + 30)


async def _collect(stream: AsyncIterator[Any], into: list[Any]) -> None:
    async for each in stream:
        into.append(each)


@asynccontextmanager
async def laboratory(peer: Peer | None = None, robot: dict[str, Any] | None = None, **kst: Any) -> AsyncIterator[Lab]:
    peer = peer or Peer()
    async with served(peer) as (host, port):
        settings = {"kst": {"host": host, "port": port, "reply_timeout": 0.2, **kst}, "robot": robot or {}}
        async with open_devices(("robot",), settings, SystemClock()) as devices:
            lab = Lab(devices["robot"], peer)
            tasks = [
                asyncio.create_task(_collect(lab.robot.events(), lab.events)),
                asyncio.create_task(_collect(lab.robot.states(), lab.states)),
            ]
            await asyncio.sleep(0)
            yield lab
            for task in tasks:
                task.cancel()
