"""The simulated world at the other end of a link, in this process."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import Any

import pytest

from pcmrs.background import background_task
from pcmrs.clock import SystemClock
from pcmrs.errors import (
    DeviceError,
)
from pcmrs_sim.process.client import WorldClient, devices_of
from pcmrs_sim.process.server import Server
from tests.unit.sim.process.world_motion import CLOCK, PATIENCE, motion, until

pytest.importorskip("mujoco")


LATE = 1000.0
"""Time that calls are on their way, s: longer than any delay of a busy machine."""


class LateClock(SystemClock):
    """Of a node whose calls are long on their way."""

    def monotonic(self) -> float:
        return super().monotonic() - LATE


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
            with pytest.raises(DeviceError, match=r"came [\d.]+ s late") as refused:
                await call
            assert LATE <= refused.value.fields["late"] <= LATE + PATIENCE
        assert not (await devices["robot"].hold()).moving
        assert not (await devices["stimulator"].disarm()).armed
