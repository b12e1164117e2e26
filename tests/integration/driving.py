"""Driving a daemon from a test: to a registered head, into a motion, and out of it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import numpy as np
from daemon_process import PATIENCE, PLAN, ServeProcess

from pcmrs.bus import Bus
from pcmrs.client import Client
from pcmrs.errors import PcmrsError
from pcmrs.messages import JointState, Verdict

AT_REST = 1e-3
"""Joint velocity below which the simulated arm counts as standing, rad/s."""
MOVES = 5e-3
LANDMARKS = {"landmarks": PLAN["landmarks"]}


async def accepted(client: Client, name: str, **arguments: object) -> Verdict:
    """Calls an operation that must be accepted."""
    verdict = await client.call(name, arguments)
    assert verdict.decision == "accepted", f"{name}: {verdict.reason}"
    return verdict


async def register(client: Client) -> None:
    """Connects the robot and registers the head, from any state with the tool away from it."""
    branches = (await client.state()).branches
    if branches["robot"] == "0":
        await accepted(client, "robot.connect")
    if branches["registration"] != "111":
        await accepted(client, "registration.plan_landmarks", **LANDMARKS)
        await accepted(client, "digitization.digitize_all")
        await accepted(client, "registration.register")
    await accepted(client, "toolplan.plan", **PLAN["poses"][0])


@asynccontextmanager
async def approaching(daemon: ServeProcess, client: Client) -> AsyncIterator[asyncio.Task[Verdict]]:
    """An approach in the middle of which the arm moves; its verdict must have come when the context ends."""
    await register(client)
    async with daemon.bus() as bus:
        moves = _moving(bus)
        verdict = asyncio.create_task(client.call("placement.approach", timeout=PATIENCE))
        try:
            async with asyncio.timeout(PATIENCE):
                await moves.wait()
            assert not verdict.done(), verdict.result()
            yield verdict
            await asyncio.wait([verdict])
        finally:
            verdict.cancel()
            with suppress(asyncio.CancelledError, PcmrsError):
                await verdict


async def recover(client: Client) -> None:
    """Releases the latch and takes the tool away from the body."""
    await accepted(client, "robot.acknowledge")
    await accepted(client, "placement.back_off")


async def stands_still(client: Client) -> bool:
    """Whether the robot itself, asked past the daemon, measures no motion."""
    state = await client.request_device("robot", "joints")
    return bool(np.abs(state["velocities"]).max() < AT_REST)


def _moving(bus: Bus) -> asyncio.Event:
    moves = asyncio.Event()

    def look(_key: str, state: JointState) -> None:
        if np.abs(state.velocities).max() > MOVES:
            moves.set()

    bus.subscribe("state/joints", JointState, look)
    return moves
