"""Driving a daemon from a test: to a registered head, into a motion, and out of it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing, asynccontextmanager, suppress

import numpy as np
from daemon_process import PATIENCE, PLAN, ServeProcess

from pcmrs.bus import Bus
from pcmrs.client import Client
from pcmrs.errors import PcmrsError
from pcmrs.messages import JointState, Snapshot, Verdict

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
    if (await client.state()).branches["placement"] == "unknown":  # the tracker was late when the robot connected
        await accepted(client, "placement.locate")


async def start_anew(client: Client) -> None:
    """Takes the cell to where a daemon begins, whatever an earlier test has left."""
    state = await client.state()
    if state.branches["robot"] == "1":
        if state.latched:
            await accepted(client, "robot.acknowledge")
        if state.branches["placement"] == "held":
            await accepted(client, "placement.back_off")
        if (await client.state()).branches["placement"] in ("standoff", "placed"):
            await accepted(client, "placement.home")
        await accepted(client, "robot.disconnect")
    await accepted(client, "registration.reinit")
    await accepted(client, "toolplan.reinit")


async def until(client: Client, **branches: str) -> None:
    """Waits until branches are in these states."""
    await until_shown(client, lambda snapshot: branches.items() <= snapshot.branches.items())


async def until_shown(client: Client, condition: Callable[[Snapshot], bool]) -> None:
    """Waits for a snapshot of which the condition holds."""
    async with asyncio.timeout(PATIENCE), aclosing(client.watch()) as events:
        async for event in events:
            if isinstance(event, Snapshot) and condition(event):
                return


@asynccontextmanager
async def approaching(daemon: ServeProcess, client: Client) -> AsyncIterator[asyncio.Task[Verdict]]:
    """An approach in the middle of which the arm moves; its verdict must have come when the context ends."""
    await register(client)
    async with daemon.bus() as bus:
        moves = _moving(bus)
        verdict = asyncio.create_task(client.call("placement.approach", timeout=PATIENCE))
        try:
            await asyncio.wait((verdict, moves), timeout=PATIENCE, return_when=asyncio.FIRST_COMPLETED)
            assert not verdict.done(), verdict.result()
            assert moves.done(), "the arm does not move"
            yield verdict
            await asyncio.wait([verdict])
        finally:
            verdict.cancel()
            with suppress(asyncio.CancelledError, PcmrsError):
                await verdict


async def stands_still(client: Client) -> bool:
    """Whether the robot itself, asked past the daemon, measures no motion."""
    state = await client.request_device("robot", "joints")
    return bool(np.abs(state["velocities"]).max() < AT_REST)


def _moving(bus: Bus) -> asyncio.Future[None]:
    moves: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def look(_key: str, state: JointState) -> None:
        if not moves.done() and np.abs(state.velocities).max() > MOVES:
            moves.set_result(None)

    bus.subscribe("state/joints", JointState, look)
    return moves
