"""Faults of devices as the whole daemon meets them: real drivers, virtual devices, nodes, bus and watches."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.devices.ndi.tools import placeholder
from pcmrs.devices.remote import RemoteScene
from pcmrs.messages import Verdict
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import accept, moving, register, reset_cell, showing, until
from tests.system.daemon.daemon_process import PATIENCE, ServeProcess, own_settings, run_pcmrs, running_daemon

pytest.importorskip("mujoco")
pytest.importorskip("ndicapy")

pytestmark = pytest.mark.slow

PATIENT = ("kst.reply_timeout=2.0", "kst.pose_limit=0.2")
"""A test machine that does much else may leave a process alone for so long."""


@pytest.fixture(scope="module")
def virtual_daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServeProcess]:
    """A daemon with the drivers of real devices, whose simulation serves the virtual ones."""
    folder = tmp_path_factory.mktemp("virtual")
    drivers = [
        "robot.driver=kst",
        "tracker.driver=ndi",
        f"kst.port={free_port()}",
        f"ndi.device=127.0.0.1:{free_port()}",
    ]
    with running_daemon([*own_settings(folder), "cell.rate=1", *drivers, *PATIENT], folder) as daemon:
        yield daemon
        assert daemon.process.poll() is None
        assert "Traceback" not in daemon.log


def _ndi() -> str:
    return f"ndi.device=127.0.0.1:{free_port()}"


@asynccontextmanager
async def scene_of(daemon: ServeProcess) -> AsyncIterator[RemoteScene]:
    async with daemon.bus() as bus:
        yield RemoteScene(bus, SystemClock())


async def connect(client: Client) -> None:
    """The virtual cabinet may listen only a moment after the daemon is ready."""
    async with asyncio.timeout(PATIENCE):
        while (await client.call("robot.connect")).decision != "accepted":  # noqa: ASYNC110
            await asyncio.sleep(0.5)


async def stands(scene: RemoteScene) -> None:
    """The arm truly stands."""
    await asyncio.sleep(1.0)
    before = await scene.truth()
    await asyncio.sleep(0.5)
    after = await scene.truth()
    way = np.subtract(after.tracker_from_coil.position, before.tracker_from_coil.position)
    assert np.linalg.norm(way) < 2e-4


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param("cut_robot", marks=pytest.mark.nightly),
        *(pytest.param(each, marks=pytest.mark.nightly) for each in ("silence_robot", "drop_client", "e_stop")),
    ],
)
async def test_a_robot_that_fails_in_motion(virtual_daemon: ServeProcess, fault: str) -> None:
    lost = fault != "e_stop"
    begin = {} if fault == "drop_client" else {"on": True}
    async with virtual_daemon.client() as client, scene_of(virtual_daemon) as scene:
        if (await client.state()).branches["robot"] == "0":
            await connect(client)
        await reset_cell(client)
        await connect(client)
        await register(client)
        async with moving(client) as approach:
            await scene.inject(fault, begin)
        verdict: Verdict = approach.result()
        assert (verdict.decision, verdict.state) == (("unknown", "unknown") if lost else ("failed", "held"))
        await until(client, lambda snapshot: snapshot.latched)
        await stands(scene)
        if lost:
            await until(client, showing(robot="0"))
        await scene.inject(fault, dict.fromkeys(begin, False))
        await asyncio.sleep(1.0)
        if lost:
            await connect(client)
            await until(client, lambda snapshot: snapshot.branches["placement"] != "unknown")
        await stands(scene)
        assert (await client.state()).latched, "an operator confirms"


@pytest.mark.parametrize(
    ("fault", "begin", "end"),
    [
        ("occlude", {"body": "body_ref", "on": True}, {"body": "body_ref", "on": False}),
        ("tracker_unplugged", {"on": True}, {"on": False}),
        ("pose_jump", {"body": "coil", "millimetres": 15.0}, {"body": "coil", "millimetres": 0.0}),
    ],
)
@pytest.mark.nightly
async def test_a_tracker_that_fails_while_the_tool_follows(
    virtual_daemon: ServeProcess, fault: str, begin: dict[str, object], end: dict[str, object]
) -> None:
    async with virtual_daemon.client() as client, scene_of(virtual_daemon) as scene:
        if (await client.state()).branches["robot"] == "0":
            await connect(client)
        await reset_cell(client)
        await connect(client)
        await register(client)
        async with moving(client):
            pass
        await accept(client, "placement.confirm")
        await accept(client, "placement.follow")
        await scene.inject(fault, begin)
        await until(client, lambda snapshot: snapshot.branches["placement"] == "held" and snapshot.latched)
        await stands(scene)
        await scene.inject(fault, end)


def test_daemon_with_a_tool_that_was_not_agreed_does_not_start(tmp_path: Path) -> None:
    tool = tmp_path / "coil.rom"
    tool.write_bytes(placeholder("coil"))
    tracker = ("tracker.driver=ndi", _ndi(), f"ndi.tools.coil={tool}", "ndi.sha256.coil=00ff")
    settings = [*own_settings(tmp_path), "cell.rate=1", *tracker]
    refused = run_pcmrs("serve", *(word for setting in settings for word in ("--set", setting)))
    assert refused.returncode == 5
    assert "is not the agreed tool definition" in refused.stderr
    assert "Check which tool is mounted" in refused.stderr
    assert "The node of tracker ended while it started" in refused.stderr
