"""Point-to-point motion of the KST driver at a virtual cabinet whose controller has no servo option."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers import kst
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.errors import ConfigurationError, DeviceError, DeviceRefusedError, UnknownOutcomeError
from pcmrs.kinematics.segments import COARSE, LONGEST
from pcmrs.messages import DeviceEvent, JointState, JointTrajectory, PressRequest
from tests.unit.devices.kst_lab import laboratory
from tests.unit.devices.kst_peer import START, Peer
from tests.unit.devices.motion.test_segments import stepped

pytest.importorskip("mujoco")

from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.server import serve_kst
from pcmrs_sim.settings import ArmSettings, SimSettings

pytestmark = pytest.mark.usefixtures("patient")

FACTS = ARMS["iiwa14"]
HOME = np.array(FACTS.home)
MODEL = ArmModel(FACTS)


@dataclass
class Bench:
    """A connected robot in point-to-point motion, its simulated arm, and what it has reported."""

    robot: Any
    cell: CellSimulation
    events: list[DeviceEvent] = field(default_factory=list)
    states: list[JointState] = field(default_factory=list)

    async def until(self, condition: Any) -> None:
        async with asyncio.timeout(20.0):
            while not condition():  # noqa: ASYNC110 - the cell sets no event
                await asyncio.sleep(0.005)

    async def under_way(self) -> asyncio.Task[Any]:
        """A motion whose first segments are over."""
        following = asyncio.create_task(self.robot.follow(stepped(0.2)))
        await self.until(lambda: np.abs(self.cell.world.arm.positions - HOME).max() > 0.02)
        return following


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    clock = SystemClock()
    async with AsyncExitStack() as stack:
        cell = CellSimulation(
            SimSettings(arm=ArmSettings(physics="kinematic")), FACTS, ForceSettings(force_limit=math.inf), clock
        )
        cell.robot_faults.servo_option = False
        stepping = asyncio.create_task(cell.run())
        stack.callback(stepping.cancel)
        host, port = await stack.enter_async_context(serve_kst(cell, "127.0.0.1", 0))
        settings = {"kst": {"host": host, "port": port, "reply_timeout": 1.0, "motion": "ptp"}}
        devices = await stack.enter_async_context(kst.open_devices(("robot",), settings, clock))
        bench = Bench(devices["robot"], cell)
        tasks = [
            asyncio.create_task(_collect(bench.robot.events(), bench.events)),
            asyncio.create_task(_collect(bench.robot.states(), bench.states)),
        ]
        await bench.robot.connect()
        yield bench
        for task in tasks:
            task.cancel()


async def _collect(stream: AsyncIterator[Any], into: list[Any]) -> None:
    async for each in stream:
        into.append(each)


async def test_a_motion_ends_where_it_was_planned(bench: Bench) -> None:
    path = stepped(0.03)
    result = await bench.robot.follow(path)
    assert (result.outcome, result.reason) == ("done", None)
    np.testing.assert_allclose(result.positions, path.positions[-1], atol=2e-5)
    np.testing.assert_allclose(bench.cell.world.arm.positions, path.positions[-1], atol=2e-5)
    assert any(state.moving for state in bench.states), "the moving arm is read"
    assert not (await bench.robot.joints()).moving
    assert bench.events == []


async def test_a_hold_is_confirmed_by_an_arm_that_stands(bench: Bench) -> None:
    following = await bench.under_way()
    before = bench.cell.world.arm.positions.copy()
    state = await bench.robot.hold()
    result = await following
    assert (result.outcome, result.reason) == ("stopped", "held")
    assert np.abs(bench.cell.world.arm.velocities).max() < 1e-3
    np.testing.assert_allclose(state.positions, bench.cell.world.arm.positions, atol=1e-4)
    way = MODEL.forward(state.positions).translation - MODEL.forward(before).translation
    assert np.linalg.norm(way) <= COARSE.distance, "no segment follows the one that was under way"
    assert (await bench.robot.follow(_there(state.positions))).outcome == "done"


async def test_a_hold_before_a_prepared_segment_starts_prevents_it() -> None:
    """The hold comes while the cabinet acknowledges speed and goal of the first segment."""
    peer = Peer()
    async with laboratory(peer, motion="ptp") as lab:
        await lab.robot.connect()
        peer.answers["jp"] = None
        following = asyncio.create_task(lab.robot.follow(stepped(0.03)))
        await lab.when(lambda: any(line.startswith("jp_") for line in peer.lines))
        holding = asyncio.create_task(lab.robot.hold())
        await asyncio.sleep(0)
        peer.say("done\n")
        assert (await following).reason == "held"
        assert np.allclose((await holding).positions, START)
        assert "doPTPinJS" not in peer.lines


async def test_a_segment_that_never_ends_has_an_unknown_outcome() -> None:
    peer = Peer()  # it answers once, as to any other command
    async with laboratory(peer, motion="ptp") as lab:
        await lab.robot.connect()
        with pytest.raises(UnknownOutcomeError, match="Look at the arm"):
            await lab.robot.follow(stepped(0.03))
        await lab.when(lambda: [event.code for event in lab.events] == ["link_lost"])
        assert peer.lines.count("doPTPinJS") == 1, "nothing is sent again"


async def test_a_force_lets_no_segment_follow(bench: Bench) -> None:
    following = await bench.under_way()
    bench.cell.world.arm.disturbance.push = 40.0
    result = await following
    assert (result.outcome, result.reason) == ("stopped", "force_limit")
    assert [event.code for event in bench.events if event.danger] == ["force_limit"]


async def test_what_needs_a_stream_is_refused(bench: Bench) -> None:
    request = PressRequest(force=2.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.005, speed=0.01, timeout=5.0)
    for act in (lambda: bench.robot.press(request), bench.robot.begin_servo):
        with pytest.raises(DeviceError, match="until a segment has ended") as refused:
            await act()
        assert refused.value.fields["code"] == "point_to_point"
    assert bench.events == []


@pytest.mark.parametrize("fault", ["drives_off", "interrupted"])
async def test_a_segment_that_breaks_off_has_failed(bench: Bench, fault: str) -> None:
    following = await bench.under_way()
    if fault == "drives_off":
        bench.cell.robot_faults.drives_off = "e_stop"
    bench.cell.world.arm.hold("interrupted" if fault == "interrupted" else "e_stop")
    with pytest.raises(DeviceError, match="cabinet"):
        await following
    await bench.until(lambda: bench.events)
    assert bench.events[0].danger
    bench.cell.robot_faults.drives_off = None


async def test_a_stream_is_refused_by_such_a_controller(bench: Bench) -> None:
    """The control: the same cabinet refuses the other mode of the driver."""
    await bench.robot.disconnect()
    async with (
        serve_kst(bench.cell, "127.0.0.1", 0) as (host, port),
        kst.open_devices(("robot",), {"kst": {"host": host, "port": port}}, SystemClock()) as devices,
    ):
        await devices["robot"].connect()
        with pytest.raises(DeviceRefusedError):
            await devices["robot"].follow(stepped(0.03))


def test_no_planned_segment_may_last_longer_than_promised() -> None:
    path = stepped(0.2)
    assert (np.diff([0, *path.stops]) * path.period).max() < LONGEST


async def test_a_force_cannot_be_relieved_in_segments() -> None:
    settings = {"kst": {"motion": "ptp"}, "robot": {"relief_mm": 2.0}}
    with pytest.raises(ConfigurationError, match="relief_mm = 0"):
        async with kst.open_devices(("robot",), settings, SystemClock()):
            pass


def _there(positions: list[float]) -> JointTrajectory:
    """A motion of one posture, which is no motion."""
    return JointTrajectory(period=0.02, positions=[positions])
