"""A real daemon beside `pcmrs ros2`, and one whose tracker ROS measures; a plain session stands for the bridge."""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zenoh

from pcmrs.client import Client
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import BodyPose
from pcmrs.ros2 import cdr
from pcmrs.spatial import Transform
from pcmrs.testing.daemon import SIMULATED_TOOL
from tests.system.daemon.daemon_process import (
    START_TIME,
    ServeProcess,
    as_words,
    own_settings,
    running_daemon,
    wait_until,
)

pytestmark = pytest.mark.nightly

POSE = Transform.from_rotvec([0.1, -0.2, 1.3], [0.3, 0.2, -0.1])


def test_command_prints_how_to_start_the_bridge_and_publishes(daemon: ServeProcess) -> None:
    """It publishes until it is ended."""
    command = [sys.executable, "-m", "pcmrs.cli", "ros2", "--json", *as_words(daemon.settings)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert process.stdout is not None
        told = json.loads(process.stdout.readline())
        assert told == {"endpoint": daemon.ready.endpoint, "namespace": f"/{daemon.ready.prefix}/ros2"}
        room = f"{daemon.ready.prefix}/ros2"
        heard: dict[str, bytes] = {}

        def take(sample: zenoh.Sample) -> None:
            heard[str(sample.key_expr).removeprefix(f"{room}/")] = sample.payload.to_bytes()

        with daemon.plain_session() as session:
            hearing: Any = session.declare_subscriber(f"{room}/**", take)
            wanted = {"joint_states", "tf", "pose/coil", "pose/body_ref"}
            assert wait_until(lambda: wanted <= heard.keys(), START_TIME), heard.keys()
            hearing.undeclare()
        joints, coil = (
            cdr.RosJointState.deserialize(heard["joint_states"]),
            cdr.decode(heard["pose/coil"], cdr.PoseStamped),
        )
        assert [*joints.name] == [joint.name for joint in ARMS["iiwa14"].joints]
        assert all(abs(time.time() - each.header.stamp.sec) < START_TIME for each in (joints, coil))
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=START_TIME)
        assert process.returncode == 0, errors.decode()
        assert all(count > 0 for count in json.loads(output).values())
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


async def until_tracker(client: Client, condition: Callable[[bool, str], object]) -> None:
    async with asyncio.timeout(START_TIME):
        while True:
            devices = (await client.health()).devices
            if any(condition(each.connected, each.text) for each in devices if each.device == "tracker"):
                return
            await asyncio.sleep(0.1)


async def test_poses_of_ros_are_those_of_the_tracker(tmp_path: Path) -> None:
    """The driver is found by its entry point: a checkout has to have been installed since it has this driver."""
    settings = [*own_settings(tmp_path), "cell.rate=1", "tracker.driver=ros2", *SIMULATED_TOOL]
    with running_daemon(settings, tmp_path) as daemon, daemon.plain_session() as session:
        async with daemon.client() as client:
            await until_tracker(client, lambda _, text: "No poses come from ROS 2" in text)
            heard: list[BodyPose] = []
            client.listen("state/pose/coil", BodyPose, heard.append)

            async def publish() -> None:
                while True:
                    payload = cdr.pose_stamped("tracker", POSE, time.time() - 0.01).serialize()
                    for body in ("coil", "body_ref", "pointer"):
                        session.put(f"{daemon.ready.prefix}/ros2/tracker/{body}", payload)
                    await asyncio.sleep(0.02)

            publishing = asyncio.create_task(publish())
            await until_tracker(client, lambda connected, _: connected)
            publishing.cancel()
            assert heard[-1].valid
            assert heard[-1].position == pytest.approx(POSE.translation.tolist())
            await until_tracker(client, lambda connected, _: not connected)
        assert "Traceback" not in daemon.log
