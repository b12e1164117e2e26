"""Latches, hold epochs and releases between a daemon and its nodes: real processes, each restarted alone."""

from __future__ import annotations

import asyncio
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.remote import RemoteRobot
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import JointTrajectory
from pcmrs.testing.driving import accept, connect, landmarks, moving, register, showing, to_standoff, until
from pcmrs_lab.campaign.delays import Delays, Rule
from tests.system.daemon.daemon_process import (
    PATIENCE,
    SLOW,
    ServeProcess,
    as_words,
    own_settings,
    running_daemon,
    stands_still,
    wait_until,
)

ARM = ("robot", "tracker", "pointer", "scene")


@contextmanager
def running_node(
    settings: Sequence[str], folder: Path, devices: Sequence[str] = ARM
) -> Iterator[subprocess.Popen[bytes]]:
    """A device node that no daemon has started: it outlives every one, as on another machine."""
    command = shlex.join([sys.executable, "-m", "pcmrs.cli", "node", "sim", *ARM, *as_words(settings)])
    (endpoint,) = (setting for setting in settings if setting.startswith("cell.endpoint=tcp/"))
    daemon = endpoint.removeprefix("cell.endpoint=tcp/").replace(":", "/")
    with (folder / "node.log").open("ab") as log:
        # A node ends where there is no daemon to connect to; only a look at the port costs nothing.
        looked = f"until (: </dev/tcp/{daemon}) 2>/dev/null; do sleep 0.05; done"
        until_there = ["bash", "-c", f"until {{ {looked}; {command}; }}; do sleep 0.1; done"]
        process = subprocess.Popen(until_there, stdout=log, stderr=log, start_new_session=True)
    try:
        yield process
    finally:
        signal_node(process, signal.SIGKILL)


def signal_node(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    """Sends a signal to a node that `running_node` has started, once."""
    if process.poll() is None:
        os.killpg(process.pid, number)
    if number == signal.SIGKILL:
        process.wait()


@pytest.fixture
def apart(tmp_path: Path) -> tuple[list[str], list[str]]:
    """Settings of a daemon without arm and tracker, and of the node that serves them elsewhere."""
    settings = [*own_settings(tmp_path), "stimulator.driver=none", "emg.driver=none"]
    return [*settings, *(f"{device}.driver=none" for device in ARM)], settings


def node_of(daemon: ServeProcess, driver: bytes) -> int:
    """Id of the node that serves `driver`."""
    return next(pid for pid in daemon.children() if driver in Path(f"/proc/{pid}/cmdline").read_bytes())


async def test_nothing_acts_before_first_connect_but_a_hand_digitizes(tmp_path: Path) -> None:
    with running_daemon(own_settings(tmp_path), tmp_path) as daemon:
        async with daemon.client() as client:
            await accept(client, "registration.plan_landmarks", **landmarks())
            await accept(client, "digitization.digitize_all")
            assert (await client.state()).branches["robot"] == "0"
            async with daemon.bus() as bus:
                robot = RemoteRobot(bus, SystemClock())
                await robot.hold()
                with pytest.raises(DeviceError, match="latched"):
                    await robot.follow(JointTrajectory(period=0.01, positions=[[0.0] * 7]))
            await connect(client)
            await register(client)
            await accept(client, "placement.approach")
        assert "Traceback" not in daemon.log


async def test_failed_motion_is_followed_by_a_retreat_without_any_stop(tmp_path: Path) -> None:
    with running_daemon([*own_settings(tmp_path), *SLOW], tmp_path) as daemon:
        async with daemon.client() as client:
            await register(client)
            async with moving(client) as approach:
                await client.request_device("scene", "occlude", {"body": "body_ref", "hidden": True})
                verdict = await approach
            assert (verdict.decision, verdict.state) == ("failed", "held")
            assert not (await client.state()).latched
            await client.request_device("scene", "occlude", {"body": "body_ref", "hidden": False})
            await accept(client, "placement.back_off")
        assert "Traceback" not in daemon.log


async def test_daemon_that_restarts_alone_holds_what_was_released(
    tmp_path: Path, apart: tuple[list[str], list[str]]
) -> None:
    of_daemon, of_node = apart
    with running_node(of_node, tmp_path) as node:
        with running_daemon(of_daemon, tmp_path) as daemon:
            async with daemon.client() as client:
                await register(client)
                await to_standoff(client)
            daemon.end(signal.SIGKILL)
        with running_daemon(of_daemon, tmp_path) as daemon:
            assert node.poll() is None
            async with daemon.client() as client:
                assert await stands_still(client)
                await register(client)
                if (await client.state()).latched:
                    await accept(client, "robot.acknowledge")
                assert (await client.state()).branches["placement"] in ("held", "retracted")
                await accept(client, "placement.back_off")
            assert "Traceback" not in daemon.log


async def test_arm_node_that_restarts_alone_is_latched_until_confirmed(
    tmp_path: Path, apart: tuple[list[str], list[str]]
) -> None:
    of_daemon, of_node = apart
    with running_daemon_and_node(of_daemon, of_node, tmp_path) as (daemon, node):
        async with daemon.client() as client:
            await register(client)
            await to_standoff(client)
            signal_node(node, signal.SIGKILL)
            await until(client, showing(robot="0", placement="unknown"))
            first = (await client.state()).stop.number
            with running_node(of_node, tmp_path):
                async with asyncio.timeout(PATIENCE):
                    while (await client.call("robot.connect")).decision != "accepted":  # noqa: ASYNC110
                        await asyncio.sleep(0.2)
                assert (await client.state()).latched
                await until(client, lambda snapshot: snapshot.branches["placement"] != "unknown")
                refused = await client.call("placement.home")
                assert refused.reason is not None
                assert refused.reason.code == "latched", "looking is allowed, moving is not"
                assert (await client.state()).stop.number >= first
                await accept(client, "robot.acknowledge")
                held = (await client.state()).branches["placement"] == "held"
                await accept(client, "placement.back_off" if held else "placement.home")
        assert "Traceback" not in daemon.log


@contextmanager
def running_daemon_and_node(
    of_daemon: Sequence[str], of_node: Sequence[str], folder: Path
) -> Iterator[tuple[ServeProcess, subprocess.Popen[bytes]]]:
    with running_node(of_node, folder) as node, running_daemon(of_daemon, folder) as daemon:
        yield daemon, node


async def test_silent_stimulator_stays_latched_and_allows_a_retreat(tmp_path: Path) -> None:
    settings = [*own_settings(tmp_path), *SLOW, "stimulator.driver=trigger", "emg.driver=none", "cell.rate=1"]
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            await register(client)
            await to_standoff(client)
            node = node_of(daemon, b"trigger")
            os.kill(node, signal.SIGSTOP)
            await client.stop()
            acknowledged = await client.acknowledge()
            assert acknowledged.decision == "accepted"
            assert acknowledged.result == {"still_latched": ["stimulator"]}
            await accept(client, "placement.back_off")
            assert not (await client.state()).latched
            os.kill(node, signal.SIGKILL)
            # Its successor starts latched, while the daemon is not: a Stop with a number of its own.
            before = (await client.state()).stop.number
            await until(client, lambda snapshot: snapshot.latched)
            assert (await client.state()).stop.number > before
            async with asyncio.timeout(PATIENCE):
                while (await client.acknowledge()).result is not None:  # noqa: ASYNC110
                    await asyncio.sleep(0.2)


async def test_daemon_is_ready_only_when_all_actors_can_be_released(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    delays = Delays(tmp_path / "delays")
    for name, value in delays.install().items():
        monkeypatch.setenv(name, value)
    first_beats = Rule("publish", "dev/stimulator/beat", seconds=2.0, times=40)
    async with delays.delaying(first_beats, ended=False):
        with running_daemon([*own_settings(tmp_path), *SLOW, "cell.rate=1"], tmp_path) as daemon:
            async with daemon.client() as client:
                connected = await client.call("robot.connect")
                assert connected.decision == "accepted"
                assert "still_latched" not in (connected.result or {})


async def test_nobody_acknowledges_while_a_hold_does_not_answer(
    tmp_path: Path, apart: tuple[list[str], list[str]]
) -> None:
    of_daemon, of_node = apart
    with running_daemon_and_node(of_daemon, of_node, tmp_path) as (daemon, node):
        async with daemon.client() as client:
            await register(client)
            signal_node(node, signal.SIGSTOP)
            number = (await client.stop()).number
            refused = await client.call("robot.acknowledge", {"stop": number})
            assert refused.reason is not None
            assert refused.reason.code == "stop_pending"
            assert not (await client.state()).stop.confirmed
            assert await asyncio.to_thread(wait_until, lambda: "hold_not_confirmed" in daemon.log)
            failed = await client.call("robot.acknowledge", {"stop": (await client.state()).stop.number})
            assert failed.decision != "accepted", "an arm that says nothing is not released"
            assert (await client.state()).latched
            signal_node(node, signal.SIGCONT)


async def test_device_request_not_from_the_daemon_moves_nothing(tmp_path: Path) -> None:
    with running_daemon(own_settings(tmp_path), tmp_path) as daemon:
        async with daemon.client() as client:
            await register(client)
            async with daemon.bus() as bus:
                stranger = RemoteRobot(bus, SystemClock())
                await stranger.joints()
                posture = (await stranger.joints()).positions
                away = [posture, [posture[0] + 0.1, *posture[1:]]]
                with pytest.raises((DeviceError, UnknownOutcomeError), match="Ask again"):
                    await stranger.follow(JointTrajectory(period=1.0, positions=away))
            assert await stands_still(client)
            assert not (await client.state()).latched
