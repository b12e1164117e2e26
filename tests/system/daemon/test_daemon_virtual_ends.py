"""Nodes that end or freeze while an arm behind a cabinet moves: the robot is lost, and found again."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pcmrs.client import Client
from pcmrs.spatial import Floats
from pcmrs.testing.daemon import command_line
from pcmrs.testing.driving import moving, register, showing, until
from tests.system.daemon.daemon_process import (
    PATIENCE,
    SLOW,
    ServeProcess,
    own_settings,
    running_daemon,
    virtual_drivers,
)

pytest.importorskip("mujoco")
pytest.importorskip("ndicapy")

pytestmark = pytest.mark.slow

STANDS = 0.2e-3
"""The arm settles so far after its last set point, m."""


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[ServeProcess]:
    with running_daemon([*own_settings(tmp_path), *SLOW, *virtual_drivers()], tmp_path) as daemon:
        yield daemon
        assert daemon.process.poll() is None
        assert "Traceback" not in daemon.log


def node_of(daemon: ServeProcess, driver: str) -> int:
    """The process id of the node of a driver."""
    (node,) = (pid for pid in daemon.children() if driver in command_line(pid))
    return node


async def lose_robot(daemon: ServeProcess, client: Client, driver: str, number: int) -> None:
    """Sends a signal to a node while the arm moves, after which the robot counts as lost."""
    await register(client)
    async with moving(client) as approach:
        os.kill(node_of(daemon, driver), number)
        verdict = await approach
    assert verdict.decision in ("failed", "unknown")
    await until(client, showing(robot="0", placement="unknown"))
    await until(client, lambda snapshot: snapshot.latched)
    for name in ("placement.approach", "placement.home", "robot.acknowledge"):
        refused = await client.call(name)
        assert refused.decision == "rejected"
        assert refused.reason is not None


async def until_accepted(client: Client, *names: str) -> None:
    """Calls operations, one after the other, again and again until the last is accepted."""
    async with asyncio.timeout(PATIENCE):
        while [(await client.call(name)).decision for name in names][-1] != "accepted":  # noqa: ASYNC110 (nobody else knows)
            await asyncio.sleep(0.1)


@pytest.mark.parametrize("driver", ["kst", "sim"])  # the driver's own node, and the one that serves the cabinet
@pytest.mark.nightly
async def test_a_node_that_is_killed_in_motion_is_a_lost_robot(daemon: ServeProcess, driver: str) -> None:
    async with daemon.client() as client:
        await lose_robot(daemon, client, driver, signal.SIGKILL)
        assert (await client.call("robot.connect")).decision in ("failed", "unknown")
        assert (await client.state()).branches["robot"] == "0"


async def coil(client: Client) -> Floats:
    """Where the tool truly is, as the simulated scene has it, m, (3,)."""
    truth = await client.request_device("scene", "truth")
    return np.array(truth["tracker_from_coil"]["position"])


@pytest.mark.nightly
async def test_frozen_node_is_a_lost_robot_and_does_not_resume_later(daemon: ServeProcess) -> None:
    async with daemon.client() as client:
        await lose_robot(daemon, client, "kst", signal.SIGSTOP)
        frozen = await coil(client)
        os.kill(node_of(daemon, "kst"), signal.SIGCONT)
        # Its session on the bus has ended, and begins anew; it tells only now that its stream was held up, which may
        # end the connection once more.
        await until_accepted(client, "robot.connect", "robot.acknowledge")
        assert np.linalg.norm(await coil(client) - frozen) < STANDS
