"""The simulated cell in its own process: what it does when its node falls silent or ends."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from pcmrs.devices.protocols import OpenDriver
from pcmrs.errors import (
    ConfigurationError,
    DeviceError,
    DeviceRefusedError,
    PayloadError,
    UnknownOutcomeError,
)
from pcmrs_sim.process.driver import open_devices
from pcmrs_sim.process.priority import raise_priority
from tests.unit.sim.process.test_priority import nice_after
from tests.unit.sim.process.world_motion import CLOCK, HOME, PATIENCE, motion, until

DRIVER: OpenDriver = open_devices  # the type checker proves it


pytest.importorskip("mujoco")

DEVICES = ("robot", "tracker", "pointer", "scene", "stimulator", "emg")


def worlds_of(pid: int) -> list[int]:
    """Ids of the simulated worlds that a process has started."""
    found = [int(each) for task in Path(f"/proc/{pid}/task").glob("*/children") for each in task.read_text().split()]
    return [each for each in found if b"pcmrs_sim.process" in Path(f"/proc/{each}/cmdline").read_bytes()]


async def test_calls_streams_and_errors_are_those_of_the_devices() -> None:
    async with asyncio.timeout(PATIENCE), open_devices(DEVICES, {}, CLOCK) as devices:
        robot, scene = devices["robot"], devices["scene"]
        assert set(devices) == set(DEVICES)
        (world,) = worlds_of(os.getpid())
        assert os.getpriority(os.PRIO_PROCESS, world) == nice_after(raise_priority)
        with pytest.raises(DeviceError, match="not connected"):
            await robot.joints()
        assert np.allclose((await robot.connect()).positions, HOME, atol=1e-3)
        done = await robot.follow(motion(1.5))
        assert (done.outcome, done.reason) == ("done", None)
        assert not (await anext(robot.states())).moving
        bodies = [pose.body for pose in await anext(devices["tracker"].frames())]
        assert bodies == ["coil", "body_ref", "pointer", "witness"]
        assert (await devices["stimulator"].set_intensity(40.0)).intensity == 40.0
        with pytest.raises(DeviceError, match="range is 0 to 100") as refused:
            await devices["stimulator"].set_intensity(percent=400.0)
        assert (type(refused.value), refused.value.fields) == (DeviceError, {"percent": 400.0})
        with pytest.raises(PayloadError, match="set_intensity"):
            await devices["stimulator"].set_intensity("much")
        await scene.inject("refuse_robot", {"on": True})
        with pytest.raises(DeviceRefusedError, match="refuses"):
            await robot.connect()
        assert robot.trouble == ""
        await scene.cut_robot(True)
        with pytest.raises(UnknownOutcomeError, match="does not answer"):
            await robot.joints()
        await until(lambda: "cut" in robot.trouble)


async def test_bad_settings_are_refused_as_in_this_process() -> None:
    with pytest.raises(ConfigurationError, match="puma560"):
        async with open_devices(("robot",), {"robot": {"model": "puma560"}}, CLOCK):
            pass
    assert not worlds_of(os.getpid())


async def test_killed_world_leaves_its_node_with_an_unknown_outcome() -> None:
    answers: list[object] = []

    async def serve() -> None:
        async with open_devices(("robot",), {}, CLOCK) as devices:
            await devices["robot"].connect()
            following = asyncio.ensure_future(devices["robot"].follow(motion(20.0)))
            following.add_done_callback(lambda done: answers.append(done.exception()))
            (world,) = worlds_of(os.getpid())
            os.kill(world, signal.SIGKILL)
            try:
                await asyncio.Event().wait()
            finally:
                with pytest.raises(UnknownOutcomeError):
                    await devices["robot"].hold()

    async with asyncio.timeout(PATIENCE):
        with pytest.raises(DeviceError, match="ended by itself"):
            await serve()
    assert [type(answer) for answer in answers] == [UnknownOutcomeError]


NODE = """
import asyncio, sys
import numpy as np
from pcmrs.clock import SystemClock
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import JointTrajectory
from pcmrs_sim.process.driver import open_devices

HOME = np.array(ARMS["iiwa14"].home)

async def tell(events):
    async for event in events:
        print(event.code, event.danger, flush=True)

async def main():
    settings = {"sim": {"stimulator": {"charge_time": 0.0}}}
    async with open_devices(("robot", "stimulator"), settings, SystemClock()) as devices:
        robot, stimulator = devices["robot"], devices["stimulator"]
        telling = [asyncio.ensure_future(tell(device.events())) for device in devices.values()]
        await robot.connect()
        await stimulator.arm()
        way = (1 - np.cos(np.linspace(0.0, np.pi, 200))) / 2
        positions = (HOME + way[:, None] * 0.5).tolist()
        following = asyncio.ensure_future(robot.follow(JointTrajectory(period=0.2, positions=positions)))
        async for state in robot.states():
            if state.moving:
                break
        print("moving", flush=True)
        result = await following
        print(result.outcome, result.reason, flush=True)
        print("armed", (await stimulator.state()).armed, flush=True)
        here = JointTrajectory(period=1.0, positions=[result.positions] * 2)
        print("again", (await robot.follow(here)).outcome, flush=True)
asyncio.run(main())
"""
"""A node whose arm moves for 40 s unless somebody stops it, and whose stimulator is armed."""


@contextmanager
def moving_node(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], int, Path]]:
    """The node, the id of its world, and the log of both."""
    log = folder / "log"
    with log.open("wb") as errors:
        node = subprocess.Popen([sys.executable, "-c", NODE], stdout=subprocess.PIPE, stderr=errors)
    try:
        assert node.stdout is not None
        assert node.stdout.readline() == b"moving\n", log.read_text()
        (world,) = worlds_of(node.pid)
        yield node, world, log
    finally:
        node.kill()
        node.wait()
        if node.stdout is not None:
            node.stdout.close()


def wait_until(condition: Callable[[], bool]) -> bool:
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_node_killed_in_motion_leaves_a_braking_arm(tmp_path: Path) -> None:
    """Its world ends."""
    with moving_node(tmp_path) as (node, world, log):
        os.kill(world, signal.SIGTERM)  # ends with its node only, which holds the arm first
        node.kill()
        assert wait_until(lambda: not is_running(world))
        said = log.read_text()
    assert "its node has ended" in said
    assert "moving=False" in said, "it has come to rest before the world ended"
    assert "Traceback" not in said


def test_node_frozen_in_motion_leaves_a_braking_arm(
    tmp_path: Path,
) -> None:
    """The stimulator disarms."""
    with moving_node(tmp_path) as (node, _, log):
        os.kill(node.pid, signal.SIGSTOP)
        assert wait_until(lambda: "its node has been silent" in log.read_text())
        os.kill(node.pid, signal.SIGCONT)
        said, _ = node.communicate(timeout=PATIENCE)
    lines = said.decode().splitlines()
    assert {"link_silent True", "disarmed False", "armed False"} <= set(lines)
    assert lines.index("stopped link_silent") < lines.index("again done"), "a node that is heard again may go on"
    assert node.returncode == 0
    assert "Traceback" not in log.read_text()
