"""The process of the simulated world frozen, killed, or busy while the arm moves: its node goes on, and says so."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from pcmrs.testing.cell import LIGHT
from pcmrs.testing.driving import accept, moving, showing, until
from tests.system.daemon.daemon_process import (
    SLOW,
    START_TIME,
    ServeProcess,
    is_running,
    own_settings,
    register_again,
    running_daemon,
    stands_still,
    wait_until,
)

REALTIME = os.SCHED_RR | os.SCHED_RESET_ON_FORK


@pytest.fixture(scope="module")
def shared_daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServeProcess]:
    folder = tmp_path_factory.mktemp("cell")
    with running_daemon([*own_settings(folder), *SLOW, *LIGHT], folder) as daemon:
        yield daemon


@pytest.fixture
async def daemon(shared_daemon: ServeProcess) -> AsyncIterator[ServeProcess]:
    await register_again(shared_daemon)
    yield shared_daemon
    assert "Traceback" not in shared_daemon.log


def policies(pid: int) -> list[int]:
    """Scheduling policy of each thread of a process, the main one first."""
    return [os.sched_getscheduler(int(task.name)) for task in sorted(Path(f"/proc/{pid}/task").iterdir())]


def test_world_is_a_fork_of_its_node(shared_daemon: ServeProcess) -> None:
    """So it has its imports already. Linux shows the title of a fork as its name, too."""
    (node,) = shared_daemon.children()
    assert Path(f"/proc/{shared_daemon.world_of(node)}/comm").read_text().strip() == sys.executable[:15]


async def test_frozen_world_does_not_delay_the_deadman_of_its_node(daemon: ServeProcess) -> None:
    (node,) = daemon.children()
    world = daemon.world_of(node)
    async with daemon.client() as client:
        async with moving(client) as approach:
            os.kill(world, signal.SIGSTOP)  # nothing can be busier
            daemon.process.send_signal(signal.SIGSTOP)
            held = await asyncio.to_thread(wait_until, lambda: "held_by_node" in daemon.log)
            daemon.process.send_signal(signal.SIGCONT)
            os.kill(world, signal.SIGCONT)
            assert held, "the node acts by its own timer, whatever the world does"
            assert (await approach).decision in ("failed", "unknown")
        await until(client, lambda snapshot: snapshot.latched and not snapshot.running)
        assert await stands_still(client)
    if os.sched_getscheduler(daemon.process.pid) == REALTIME:  # where it is permitted
        assert policies(node)[0] == REALTIME
    assert set(policies(world)) == {os.SCHED_OTHER}


async def test_world_frozen_in_motion_is_a_lost_robot_until_restarted(daemon: ServeProcess) -> None:
    (node,) = daemon.children()
    world = daemon.world_of(node)
    async with daemon.client() as client:
        async with moving(client) as approach:
            os.kill(world, signal.SIGSTOP)
            verdict = await approach
        assert (verdict.decision, verdict.state) == ("unknown", "unknown")
        await until(client, showing(robot="0", placement="unknown"))
        await until(client, lambda snapshot: snapshot.latched)
        assert is_running(node)
        os.kill(world, signal.SIGKILL)
        assert await asyncio.to_thread(wait_until, lambda: "node_ended" in daemon.log)
        assert "The simulated cell has ended by itself (status -9)" in daemon.log
        async with asyncio.timeout(START_TIME):
            while (await client.call("robot.connect")).decision != "accepted":  # noqa: ASYNC110
                await asyncio.sleep(0.2)
        await accept(client, "robot.acknowledge")
        (successor,) = daemon.children()
        assert successor != node
        assert daemon.world_of(successor) != world


async def test_a_world_that_dies_in_motion_leaves_an_unknown_outcome(daemon: ServeProcess) -> None:
    (node,) = daemon.children()
    async with daemon.client() as client:
        async with moving(client) as approach:
            os.kill(daemon.world_of(node), signal.SIGKILL)
            verdict = await approach
        assert (verdict.decision, verdict.state) == ("unknown", "unknown")
        await until(client, showing(robot="0", placement="unknown"))
        await until(client, lambda snapshot: snapshot.latched)


async def test_node_frozen_in_motion_leaves_an_arm_braked_by_its_world(daemon: ServeProcess) -> None:
    (node,) = daemon.children()
    async with daemon.client() as client:
        async with moving(client) as approach:
            os.kill(node, signal.SIGSTOP)
            braked = await asyncio.to_thread(wait_until, lambda: "held_by_world" in daemon.log)
            os.kill(node, signal.SIGCONT)
            assert braked
            assert (await approach).decision in ("failed", "unknown")
        await until(client, lambda snapshot: snapshot.latched and not snapshot.running)
        assert await stands_still(client)


async def test_node_killed_in_motion_ends_its_world_at_rest(daemon: ServeProcess) -> None:
    (node,) = daemon.children()
    world = daemon.world_of(node)
    async with daemon.client() as client:
        async with moving(client):
            os.kill(node, signal.SIGKILL)
            assert await asyncio.to_thread(wait_until, lambda: not is_running(world))
        assert "its node has ended" in daemon.log
        assert "moving=False" in daemon.log
