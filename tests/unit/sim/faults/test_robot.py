"""Faults of the robot, on the cabinet's wire and on the built-in robot."""

import asyncio
from collections.abc import AsyncIterator

import numpy as np
import pytest
import pytest_asyncio

from pcmrs.clock import SystemClock
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs_sim.cell import CellSimulation, running_cell
from pcmrs_sim.faults import inject
from pcmrs_sim.kst.server import serve_kst
from pcmrs_sim.robot import SimRobot
from tests.unit.sim.kst_client import DONE, NAK, ROUNDING, KstClient, at_rest, client_of, connected, line
from tests.unit.sim.simulated_arms import smooth

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def cell() -> AsyncIterator[CellSimulation]:
    async with running_cell({"robot": {"driver": "kst"}}, SystemClock()) as cell:
        yield cell


@pytest_asyncio.fixture(loop_scope="module")
async def client(cell: CellSimulation) -> AsyncIterator[KstClient]:
    await at_rest(cell)
    async with client_of(cell) as client:
        yield client


async def begin_motion(cell: CellSimulation, client: KstClient, way: float = 0.4) -> float:
    """Begins a motion of joint 1 that takes a while; where it would end."""
    goal = np.array(await client.joints())
    start = goal[0]
    goal[0] = start + way * (-1.0 if start > 0.0 else 1.0)
    assert await client.ask("jRelVel_0.2_") == DONE
    assert await client.ask(line("jp", goal)) == DONE
    assert await client.ask("doPTPinJS") == DONE
    while abs((await client.joints())[0] - start) < 0.02:
        await cell.clock.sleep(0.01)
    return float(goal[0])


@pytest.mark.parametrize("fault", ["e_stop", "change_mode", "close_brakes"])
async def test_motion_ends_without_drives_and_starts_only_with_them(
    cell: CellSimulation, client: KstClient, fault: str
) -> None:
    goal = await begin_motion(cell, client)
    inject(cell, fault, {})
    assert await client.reply() == NAK
    await at_rest(cell)
    assert abs((await client.joints())[0] - goal) > 0.1
    for command in ("doPTPinJS", "doPTPinCS", "startDirectServoJoints", "startSmartImpedneceJoints_1_0_0_0_1_1_1_"):
        assert await client.ask(command) == NAK
    inject(cell, fault, {"on": False})
    assert await client.ask("startDirectServoJoints") == DONE


async def test_an_emergency_stop_ends_a_servo(cell: CellSimulation, client: KstClient) -> None:
    assert await client.ask("startDirectServoJoints") == DONE
    inject(cell, "e_stop", {"on": True})
    assert await client.reply() == NAK
    inject(cell, "e_stop", {"on": False})


async def test_interrupted_motion_is_answered_as_interrupted(cell: CellSimulation, client: KstClient) -> None:
    goal = await begin_motion(cell, client)
    inject(cell, "interrupt", {})
    assert await client.reply() == b"interrupted\n"
    await at_rest(cell)
    assert abs((await client.joints())[0] - goal) > 0.1


async def test_a_cut_link_makes_the_arm_brake_and_ends_the_connection(cell: CellSimulation, client: KstClient) -> None:
    goal = await begin_motion(cell, client)
    inject(cell, "cut_robot", {"on": True})
    client.send("getJointsPositions")
    await at_rest(cell)
    assert abs(cell.world.arm.positions[0] - goal) > 0.1
    inject(cell, "cut_robot", {"on": False})
    assert await client.until_closed() == b""


async def test_silent_robot_still_obeys_commands(cell: CellSimulation, client: KstClient) -> None:
    goal = np.array(await client.joints()) * [0.5, 1, 1, 1, 1, 1, 1]
    inject(cell, "silence_robot", {})
    client.send("jRelVel_0.3_", line("jp", goal), "doPTPinJS")
    while np.abs(cell.world.arm.positions - goal).max() > ROUNDING:
        await cell.clock.sleep(0.01)
    await at_rest(cell)
    inject(cell, "silence_robot", {"on": False})
    assert len(await client.joints()) == 7


async def test_a_joint_goes_beside_what_is_commanded(cell: CellSimulation, client: KstClient) -> None:
    before = np.array(await client.joints())
    inject(cell, "offset_joint", {"joint": 3, "angle": 0.05})
    try:
        await client.ask("jRelVel_0.2_")
        await client.ask(line("jp", before))
        assert await client.ask("doPTPinJS", replies=2) == DONE + DONE
        beside = np.array(await client.joints()) - before
        assert np.allclose(beside, [0, 0, 0.05, 0, 0, 0, 0], atol=2 * ROUNDING)
    finally:
        inject(cell, "offset_joint", {"joint": 3, "angle": 0.0})
    while np.abs(np.array(await client.joints()) - before).max() > 2 * ROUNDING:
        await cell.clock.sleep(0.01)


async def test_the_arm_is_moved_by_hand_while_nobody_is_connected(cell: CellSimulation) -> None:
    async with serve_kst(cell, port=0) as (host, port):
        async with connected(host, port) as client:
            before = np.array(await client.joints())
        inject(cell, "guide_by_hand", {"joint": 4, "angle": 0.1})
        await at_rest(cell)
        async with connected(host, port) as client:
            moved = np.array(await client.joints()) - before
    assert np.allclose(moved, [0, 0, 0, 0.1, 0, 0, 0], atol=2 * ROUNDING)
    inject(cell, "guide_by_hand", {"joint": 4, "angle": -0.1})
    with pytest.raises(DeviceError, match="while it rests"):
        inject(cell, "guide_by_hand", {"joint": 4, "angle": 0.1})


async def test_a_hand_turns_no_joint_beyond_its_stop(cell: CellSimulation) -> None:
    joint = cell.facts.joints[3]
    for _ in range(8):
        await at_rest(cell)
        inject(cell, "guide_by_hand", {"joint": 4, "angle": -0.5})
        await cell.clock.sleep(0.1)
    await at_rest(cell)
    assert cell.world.arm.reference.position[3] == pytest.approx(joint.lower, abs=0.01)


async def test_the_application_fails_and_the_next_client_is_served(cell: CellSimulation) -> None:
    async with serve_kst(cell, port=0) as (host, port):
        async with connected(host, port) as client:
            assert len(await client.joints()) == 7
            inject(cell, "drop_client", {})
            with pytest.raises((ConnectionError, AssertionError)):
                assert await client.until_closed() != b""
        async with connected(host, port) as client:
            assert len(await client.joints()) == 7


async def test_repeated_command_is_answered_twice_but_moves_once(cell: CellSimulation, client: KstClient) -> None:
    goal = np.array(await client.joints())
    goal[0] -= 0.05
    inject(cell, "double_commands", {})
    try:
        assert await client.ask("jRelVel_0.2_", replies=2) == DONE + DONE
        assert await client.ask(line("jp", goal), replies=2) == DONE + DONE
        assert await client.ask("doPTPinJS", replies=2) == DONE + DONE  # accepted once, finished once
    finally:
        inject(cell, "double_commands", {"on": False})
    assert len(await client.joints()) == 7


@pytest.mark.parametrize("framing", ["split", "merged", "whole", "mixed"])
async def test_however_replies_are_framed_they_are_the_same(
    cell: CellSimulation, client: KstClient, framing: str
) -> None:
    inject(cell, "frame_replies", {"how": framing})
    client.send("jRelVel_0.2_", "jRelVel_0.2_", "getJointsPositions", "jRelVel_0.2_")
    assert [len((await client.reply()).split(b"_")) for _ in range(4)] == [1, 1, 8, 1]
    inject(cell, "frame_replies", {"how": "whole"})


async def test_a_collision_pushes_the_arm_away_from_where_it_holds(cell: CellSimulation, client: KstClient) -> None:
    before = np.array(await client.joints())
    inject(cell, "push_tool", {"force": 80.0})
    while np.abs(np.array(await client.joints()) - before).max() < 1e-4:
        await cell.clock.sleep(0.005)
    while (await client.values("Eef_force"))[2] > -75.0:
        await cell.clock.sleep(0.005)
    inject(cell, "push_tool", {"force": 0.0})


class TestBuiltInRobot:
    """The same faults behind the protocol of the robot."""

    @pytest_asyncio.fixture(loop_scope="module")
    async def robot(self, cell: CellSimulation) -> SimRobot:
        await at_rest(cell)
        robot = cell.devices["robot"]
        assert isinstance(robot, SimRobot)
        await robot.connect()
        return robot

    async def test_emergency_stop_in_motion_is_danger_and_bars_the_next(
        self, cell: CellSimulation, robot: SimRobot
    ) -> None:
        events = robot.events()
        heard = asyncio.ensure_future(anext(events))
        start = np.array((await robot.joints()).positions)
        motion = asyncio.create_task(robot.follow(smooth(start, start + 0.1)))
        while abs(cell.world.arm.positions[0] - start[0]) < 0.01:
            await cell.clock.sleep(0.01)
        inject(cell, "e_stop", {})
        result = await motion
        event = await heard
        assert (result.outcome, result.reason) == ("stopped", "e_stop")
        assert (event.danger, event.code, event.fields) == (True, "drives_off", {"reason": "e_stop"})
        with pytest.raises(DeviceError, match="drives are off"):
            await robot.begin_servo()
        inject(cell, "e_stop", {"on": False})
        session = await robot.begin_servo()
        assert (await robot.end_servo(session.session)).outcome in ("done", "stopped")

    async def test_a_silent_robot_does_not_answer(self, cell: CellSimulation, robot: SimRobot) -> None:
        inject(cell, "silence_robot", {"on": True})
        with pytest.raises(UnknownOutcomeError):
            await robot.joints()
        inject(cell, "silence_robot", {"on": False})
        assert len((await robot.joints()).positions) == 7
