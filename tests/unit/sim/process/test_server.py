"""The simulated world at the other end of a link, in this process."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest

from pcmrs.background import background_task
from pcmrs.clock import SystemClock
from pcmrs.errors import (
    DeviceError,
)
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import JointTrajectory
from pcmrs_sim.process.client import WorldClient, devices_of
from pcmrs_sim.process.server import Server

pytest.importorskip("mujoco")

HOME = np.array(ARMS["iiwa14"].home)
CLOCK = SystemClock()
PATIENCE = 60.0


def motion(seconds: float) -> JointTrajectory:
    way = (1 - np.cos(np.linspace(0.0, np.pi, 200))) / 2
    return JointTrajectory(period=seconds / 199, positions=(HOME + way[:, None] * 0.5).tolist())


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


class LateClock(SystemClock):
    """Of a node whose calls are long on their way."""

    def monotonic(self) -> float:
        return super().monotonic() - 5.0


@asynccontextmanager
async def linked(machine: SystemClock = CLOCK) -> AsyncIterator[tuple[Server, Mapping[str, Any]]]:
    """Both ends of a link in one process, so that a test can act between two steps of the world."""
    here, there = socket.socketpair()
    server, world = Server(there), WorldClient(here, machine, lambda: None)
    serving = asyncio.create_task(server.run())
    try:
        await world.open(("robot", "stimulator"), {})
        async with background_task(world.beat(0.1)):
            yield server, devices_of(world, ("robot", "stimulator"), CLOCK)
    finally:
        world.close()
        await serving


async def test_a_hold_that_has_arrived_acts_before_more_physics() -> None:
    async with asyncio.timeout(PATIENCE), linked() as (server, devices):
        cell, robot = server.cell, devices["robot"]
        await robot.connect()
        following = asyncio.create_task(robot.follow(motion(20.0)))
        await until(lambda: cell.robot.follows)
        holding = asyncio.create_task(robot.hold())
        await asyncio.sleep(0)  # it is on its way, and the world has not looked yet
        assert cell.robot.follows
        cell.advance(cell.world.time + 0.02)
        assert not cell.robot.follows
        await holding
        assert (await following).reason == "held"


async def test_late_action_is_refused_and_a_late_hold_is_not() -> None:
    async with asyncio.timeout(PATIENCE), linked(LateClock()) as (_, devices):
        await devices["robot"].connect()
        for call in (devices["robot"].follow(motion(5.0)), devices["stimulator"].arm()):
            with pytest.raises(DeviceError, match=r"came 5\.0 s late"):
                await call
        assert not (await devices["robot"].hold()).moving
        assert not (await devices["stimulator"].disarm()).armed
