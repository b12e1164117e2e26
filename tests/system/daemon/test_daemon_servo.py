"""A stream of set points and the robot's own alarms, over the real bus into the latch of the daemon."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.devices.remote import RemoteRobot, RemoteScene
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Transform
from pcmrs.testing.driving import accept, until
from pcmrs_sim.head import surface_point
from pcmrs_sim.settings import GeometrySettings
from tests.system.daemon.daemon_process import ServeProcess, own_settings, run_pcmrs, running_daemon

ARM, GEOMETRY = ARMS["iiwa14"], GeometrySettings()
GAP = 0.005


def head_before_tool() -> Transform:
    """``world_from_image`` with the crown of the head `GAP` before the tool of the arm at home."""
    tool = ArmModel(ARM).forward(ARM.home) @ GEOMETRY.flange_from_tool_tip.transform
    return tool @ Transform(np.eye(3), np.array([0.0, 0.0, -GAP]) - surface_point((0.0, 0.0, 1.0)))


async def stream(robot: RemoteRobot, end: bool) -> None:
    """Half a second of set points; then the session is ended, or simply forgotten."""
    posture = np.array((await robot.joints()).positions)
    speed = np.array([0.0] * 6 + [0.05])
    if end:
        async with robot.servo() as setpoints:
            for number in range(40):
                setpoints.send(posture + speed * number * 0.016, speed)
                await asyncio.sleep(0.016)
    else:
        await robot.begin_servo()


async def heard_alarm(daemon: ServeProcess, client: Client, code: str) -> None:
    await until(client, lambda snapshot: snapshot.latched)
    assert code in run_pcmrs("journal", "show", daemon.ready.journal).stdout
    await accept(client, "robot.acknowledge")


@pytest.mark.nightly
async def test_the_robots_own_alarms_stop_and_latch(tmp_path: Path) -> None:
    place = head_before_tool()
    settings = [
        *own_settings(tmp_path),
        "cell.rate=1",
        "robot.force_limit=5",
        f"sim.geometry.world_from_image.position={place.translation.tolist()}",
        f"sim.geometry.world_from_image.quat_wxyz={place.quat_wxyz.tolist()}",
    ]
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client, daemon.bus() as bus:
            robot, scene = RemoteRobot(bus, SystemClock()), RemoteScene(bus, SystemClock())
            await accept(client, "robot.connect")
            before = (await robot.joints()).positions
            await stream(robot, end=True)
            assert (await robot.joints()).positions[6] - before[6] > 0.02
            assert not (await client.state()).latched
            await stream(robot, end=False)
            await heard_alarm(daemon, client, "servo_held")
            towards = GEOMETRY.world_from_tracker.transform.inverse().rotation @ place.rotation[:, 2]
            x, y, z = ((GAP + 0.008) * towards).tolist()
            await scene.move_body((x, y, z))
            await heard_alarm(daemon, client, "force_limit")
        assert "Traceback" not in daemon.log
