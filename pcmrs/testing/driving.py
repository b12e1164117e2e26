"""Operating a cell over the bus: to a registered head, into a motion, and out of it; every command must be accepted."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing, asynccontextmanager, suppress
from functools import cache
from typing import Any

import msgspec
import numpy as np

from pcmrs.client import Client
from pcmrs.errors import PcmrsError
from pcmrs.messages import JointState, Snapshot, Verdict
from pcmrs.testing.errors import Unmet
from pcmrs.testing.plan import Plan, example_plan, read_plan

__all__ = [
    "accept",
    "acknowledge",
    "approach_alone",
    "connect",
    "digitize_landmarks",
    "landmarks",
    "moving",
    "plan",
    "reason_text",
    "register",
    "reset_cell",
    "showing",
    "state",
    "to_placed",
    "to_retracted",
    "to_standoff",
    "tool_pose",
    "until",
    "wait_until_stationary",
]

PATIENCE = 20.0
"""Longest wait for an expected event, s of the machine."""
RETRY = 0.5
"""Pause between two attempts to connect the robot, s."""
SEEN = 0.5
"""Time after which the tracker has seen the arm at rest, s of the machine."""
MOVES = 5e-3
"""Joint velocity above which the simulated arm counts as moving, rad/s."""


@cache
def plan() -> Plan:
    """Return the landmarks and poses of the example plan."""
    return read_plan(example_plan("ratms"))


def landmarks() -> dict[str, Any]:
    """Return the arguments of ``registration.plan_landmarks``."""
    return {"landmarks": msgspec.to_builtins(plan().landmarks)}


def tool_pose(number: int = 0) -> dict[str, Any]:
    """Return the arguments of ``toolplan.plan`` for a pose of the example plan."""
    pose: dict[str, Any] = msgspec.to_builtins(plan().poses[number])
    return pose


ACKNOWLEDGE = "robot.acknowledge"


async def acknowledge(client: Client) -> Verdict:
    """Acknowledge the newest Stop by its number; repeat it if a newer one has arrived."""
    while True:
        verdict = await client.acknowledge(stop=(await client.state()).stop.number)
        if verdict.reason is None or verdict.reason.code != "stop_outdated":
            return verdict


async def accept(client: Client, name: str, **arguments: object) -> Verdict:
    """Call an operation that must be accepted.

    Args:
        client: Client of the cell.
        name: Name of the operation, ``branch.operation``.
        **arguments: Arguments of the operation.

    Raises:
        Unmet: The operation was not accepted.
    """
    verdict = await (acknowledge(client) if name == ACKNOWLEDGE else client.call(name, arguments))
    if verdict.decision != "accepted":
        raise Unmet(f"{name} was {verdict.decision}: {reason_text(verdict)}")
    return verdict


def reason_text(verdict: Verdict) -> str:
    """Return the reason for which a command was not accepted."""
    return f"{verdict.reason.code}: {verdict.reason.text}" if verdict.reason is not None else "no reason"


async def state(client: Client, branch: str) -> str:
    """Return the present state of a branch.

    Args:
        client: Client of the cell.
        branch: Name of the branch.
    """
    return (await client.state()).branches[branch]


async def reset_cell(client: Client) -> None:
    """Bring the cell to the initial state of a daemon, from any state that an earlier fault has left.

    Raises:
        Unmet: A command was not accepted.
    """
    before = await client.state()
    if before.branches.get("stimulation", "disarmed") != "disarmed":
        await accept(client, "stimulation.disarm")
    if before.branches["robot"] == "0" and before.latched:
        await accept(client, "robot.connect")
        before = await client.state()
    if before.branches["robot"] == "1":
        await _disconnect_robot(client)
    await accept(client, "registration.reinit")
    await accept(client, "toolplan.reinit")


async def _disconnect_robot(client: Client) -> None:
    if (await client.state()).latched:
        await accept(client, "robot.acknowledge")
    if await state(client, "placement") == "held":
        await accept(client, "placement.back_off")
    if await state(client, "placement") not in ("unknown", "retracted"):
        await accept(client, "placement.home")
    await accept(client, "robot.disconnect")


async def wait_until_stationary(client: Client) -> None:
    """Bring the cell out of any state that an earlier fault has left, and keep its registration.

    Raises:
        Unmet: A command was not accepted.
    """
    shown = await client.state()
    if shown.latched:
        if shown.branches["robot"] == "0":
            await connect(client)
        await accept(client, "robot.acknowledge")
    if await state(client, "placement") == "held":
        await accept(client, "placement.back_off")


async def connect(client: Client) -> None:
    """Connect the robot; tries again, because a virtual cabinet may be ready later than the daemon.

    Raises:
        Unmet: The command was not accepted within `PATIENCE`.
    """
    with suppress(TimeoutError):
        async with asyncio.timeout(PATIENCE):
            while (await client.call("robot.connect")).decision != "accepted":  # noqa: ASYNC110
                await asyncio.sleep(RETRY)
            return
    raise Unmet(f"The robot was not connected within {PATIENCE:g} s.")


async def digitize_landmarks(client: Client) -> None:
    """Plan the landmarks and digitize them."""
    await accept(client, "registration.plan_landmarks", **landmarks())
    await accept(client, "digitization.digitize_all")


async def register(client: Client) -> None:
    """Connect the robot, register the head and plan a pose, as far as that is not done."""
    before = (await client.state()).branches
    if before["robot"] == "0":
        await connect(client)
    if before["registration"] != "111":
        await digitize_landmarks(client)
        await accept(client, "registration.register")
    if before["toolplan"] == "0":
        await accept(client, "toolplan.plan", **tool_pose())
    await until(client, lambda snapshot: not snapshot.running)
    if await state(client, "placement") == "unknown":  # the tracker was late when the robot connected
        await accept(client, "placement.locate")


async def to_retracted(client: Client) -> None:
    """Register the head and move the tool away from it."""
    await register(client)
    if await state(client, "placement") == "held":
        await accept(client, "placement.back_off")
    if await state(client, "placement") != "retracted":
        await accept(client, "placement.home")


async def to_standoff(client: Client) -> None:
    """Register the head and move the tool to the standoff."""
    await register(client)
    if await state(client, "placement") in ("placed", "following", "guided", "replanned", "held"):
        await accept(client, "placement.back_off")
    if await state(client, "placement") != "standoff":
        await accept(client, "placement.approach")


async def to_placed(client: Client) -> None:
    """Register the head and move the tool to its planned pose."""
    await register(client)
    if await state(client, "placement") != "placed":
        await to_standoff(client)
        await accept(client, "placement.confirm")


def showing(**branches: str) -> Callable[[Snapshot], bool]:
    """Return a condition for `until`: True for a snapshot with these states of branches."""
    return lambda snapshot: branches.items() <= snapshot.branches.items()


async def until(client: Client, condition: Callable[[Snapshot], bool], within: float = PATIENCE) -> Snapshot:
    """Wait for a snapshot that fulfils a condition, and return it.

    Args:
        client: Client of the cell.
        condition: Returns True for a snapshot that fulfils it.
        within: Longest wait, s of the machine.

    Raises:
        Unmet: No snapshot fulfilled it in time; the text has the last one.
    """
    last: Snapshot | None = None
    with suppress(TimeoutError):
        async with asyncio.timeout(within), aclosing(client.watch()) as events:
            async for event in events:
                last = event if isinstance(event, Snapshot) else last
                if last is not None and condition(last):
                    return last
    shown = "nothing" if last is None else f"{last.branches}, latched {last.latched}"
    raise Unmet(f"The expected state did not come within {within:g} s; shown last: {shown}.")


@asynccontextmanager
async def moving(
    client: Client,
    name: str = "placement.approach",
    id: str | None = None,
    arguments: dict[str, Any] | None = None,
) -> AsyncIterator[asyncio.Task[Verdict]]:
    """Start a motion and wait until the arm moves; leaving the context waits for the verdict.

    Args:
        client: Client of the cell.
        name: Name of the operation that moves the arm, ``branch.operation``.
        id: Id of the command; by default a new one.
        arguments: Arguments of the operation by name.

    Raises:
        Unmet: The arm did not move, or no verdict came within `PATIENCE`.
    """
    await asyncio.sleep(SEEN)
    moves, end = await _motion(client)
    verdict = asyncio.create_task(client.call(name, arguments, id=id, timeout=PATIENCE))
    try:
        await asyncio.wait((verdict, moves), timeout=PATIENCE, return_when=asyncio.FIRST_COMPLETED)
        if not moves.done() or verdict.done():
            raise Unmet(f"The arm does not move: {verdict.result() if verdict.done() else 'no verdict'}.")
        yield verdict
        await asyncio.wait([verdict], timeout=PATIENCE)
        if not verdict.done():
            raise Unmet(f"{name} had no verdict within {PATIENCE:g} s.")
    finally:
        await end()
        verdict.cancel()
        with suppress(asyncio.CancelledError, PcmrsError):
            await verdict


async def approach_alone(client: Client) -> Verdict:
    """Register and approach without any other command, as a control.

    Raises:
        Unmet: The approach was not accepted.
    """
    await register(client)
    async with moving(client) as approach:
        verdict = await approach
    if verdict.decision != "accepted":
        raise Unmet(f"An undisturbed approach was {verdict.decision}: {reason_text(verdict)}")
    return verdict


async def _motion(client: Client) -> tuple[asyncio.Future[None], Callable[[], Awaitable[None]]]:
    moves: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def look(joints: JointState) -> None:
        if not moves.done() and np.abs(joints.velocities).max() > MOVES:
            moves.set_result(None)

    return moves, client.listen("state/joints", JointState, look)
