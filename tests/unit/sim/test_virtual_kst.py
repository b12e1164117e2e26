"""The virtual cabinet, byte by byte over a real socket: every request of the KST server and its reply."""

import re
from collections.abc import AsyncIterator

import numpy as np
import pytest
import pytest_asyncio

from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError
from pcmrs.kinematics.model import ArmModel
from pcmrs_sim.cell import CellSimulation, running_cell
from pcmrs_sim.kst.readings import from_xyzabc
from pcmrs_sim.kst.server import serve_kst
from tests.unit.sim.kst_client import KstClient, at_rest, client_of, connected, line
from tests.unit.sim.simulated_arms import FACTS, HOME

pytestmark = pytest.mark.asyncio(loop_scope="module")

DONE = b"done\n"
NUMBER = rb"-?\d+\.\d+(E-?\d+)?_"
ROUNDING = 6e-5  # rad: of five decimals and of an arm at rest
MODEL = ArmModel(FACTS)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def cell() -> AsyncIterator[CellSimulation]:
    async with running_cell({"robot": {"driver": "kst"}}, SystemClock()) as cell:
        yield cell


@pytest_asyncio.fixture(loop_scope="module")
async def client(cell: CellSimulation) -> AsyncIterator[KstClient]:
    await at_rest(cell)
    async with client_of(cell) as client:
        yield client


@pytest.mark.parametrize(
    ("question", "count"),
    [
        ("getJointsPositions", 7),
        ("Torques_ext_J", 7),
        ("Torques_m_J", 7),
        ("Eef_pos", 6),
        ("Eef_force", 3),
        ("Eef_moment", 3),
    ],
)
async def test_questions_are_answered_with_so_many_numbers(client: KstClient, question: str, count: int) -> None:
    assert re.fullmatch(rb"(%s){%d}\n" % (NUMBER, count), await client.ask(question))


async def test_the_pose_is_in_millimetres_and_of_the_tool_frame(client: KstClient) -> None:
    flange = from_xyzabc(await client.values("Eef_pos"))
    assert await client.ask("TFtrans_10.0_20.0_150.0_0.5_0.0_3.14159") == DONE
    tool = from_xyzabc(await client.values("Eef_pos"))
    joints = await client.joints()
    assert np.allclose(flange.matrix, MODEL.forward(joints).matrix, atol=1e-6)
    expected = MODEL.forward(joints) @ from_xyzabc([10.0, 20.0, 150.0, 0.5, 0.0, 3.14159])
    assert np.allclose(tool.matrix, expected.matrix, atol=1e-6)


async def test_a_joint_motion_is_accepted_and_then_finished(client: KstClient) -> None:
    goal = HOME + np.array((0.1, 0.05, 0.0, 0.0, -0.05, 0.0, 0.1))
    assert await client.ask("jRelVel_0.3_") == DONE
    assert await client.ask(line("jp", goal)) == DONE
    assert await client.ask("doPTPinJS", replies=2) == DONE + DONE
    assert np.allclose(await client.joints(), goal, atol=ROUNDING)


async def test_a_straight_motion_ends_at_its_pose(client: KstClient) -> None:
    assert await client.ask("TFtrans_0_0_150_0_0_0") == DONE
    pose = await client.values("Eef_pos")
    pose[2] += 20.0
    assert await client.ask("jRelVel_60_") == DONE  # mm/s for these
    assert await client.ask(line("cArtixanPosition", pose)) == DONE
    assert await client.ask("doPTPinCS", replies=2) == DONE + DONE
    assert np.allclose((await client.values("Eef_pos"))[:3], pose[:3], atol=0.1)


@pytest.mark.parametrize("preparation", ["jRelVel_0_", "jRelVel_1.5_", "jRelVel_1e-4_"])
async def test_an_impossible_speed_is_a_nak_after_the_acceptance(client: KstClient, preparation: str) -> None:
    assert await client.ask(preparation) == DONE
    assert await client.ask("doPTPinJS", replies=2) == DONE + b"nak\n"


async def test_an_unreachable_goal_is_a_nak(client: KstClient) -> None:
    await client.ask("jRelVel_0.2_")
    await client.ask(line("jp", [0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert await client.ask("doPTPinJS", replies=2) == DONE + b"nak\n"
    await client.ask(line("cArtixanPosition", [2000.0, 0.0, 500.0, 0.0, 0.0, 0.0]))
    await client.ask("jRelVel_50_")
    assert await client.ask("doPTPinCS", replies=2) == DONE + b"nak\n"


@pytest.mark.parametrize("request_", ["TFtrans_1_2_3", "jRelVel_fast_", "startSmartImpedneceJoints_1_x_"])
async def test_wrong_numbers_are_a_nak(client: KstClient, request_: str) -> None:
    assert await client.ask(request_) == b"nak\n"


async def test_a_servo_stream_is_followed_to_its_last_set_point(cell: CellSimulation, client: KstClient) -> None:
    start = np.array(await client.joints())
    assert await client.ask("startDirectServoJoints") == DONE
    for step in range(1, 41):
        client.send(line("jf", start + step * 0.002))  # no reply
        await cell.clock.sleep(0.005)
    goal = start + 0.08
    assert re.fullmatch(rb"(%s){7}\n" % NUMBER, await client.ask(line("jpJP", goal)))
    for answered in ("jpExT", "jpMT"):
        assert len(await client.values(line(answered, goal))) == 7
    assert len(await client.values(line("jpEEfP", goal))) == 3
    assert await client.ask(line("jp", goal)) == DONE
    while np.abs(np.array(await client.joints()) - goal).max() > ROUNDING:
        await cell.clock.sleep(0.02)  # it goes there, with nothing more to be sent
    assert await client.ask("stopDirectServoJoints") == DONE
    assert await client.ask("startDirectServoJoints") == DONE  # waits until the arm rests
    assert await client.ask("stopDirectServoJoints") == DONE


async def test_stopped_servo_ends_when_the_arm_has_braked(
    cell: CellSimulation, client: KstClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It does not matter how slowly the arm settles."""
    monkeypatch.setattr(type(cell.world.arm), "at_rest", False)
    assert await client.ask("startDirectServoJoints") == DONE
    assert await client.ask("stopDirectServoJoints") == DONE
    assert len(await client.values("Torques_ext_J")) == 7


async def test_servo_with_impedance_is_acknowledged_twice_at_its_end(client: KstClient) -> None:
    joints = await client.joints()
    assert await client.ask(line("jp", joints)) == DONE
    assert await client.ask("startSmartImpedneceJoints_1.2_0_0_50_2000_200_100_") == DONE
    assert len(await client.values(line("jpJP", joints))) == 7
    assert await client.ask("stopDirectServoJoints", replies=2) == DONE + DONE
    assert await client.ask("startSmartImpedneceJoints_1.2_0_0_50_9000_200_100_", replies=2) == DONE + DONE


async def test_impedance_takes_joint_1_to_what_was_sent_last(cell: CellSimulation, client: KstClient) -> None:
    start = np.array(await client.joints())
    start[0] -= 0.02
    await client.ask(line("jp", start))
    assert await client.ask("startSmartImpedneceJoints_1_0_0_50_2000_200_100_") == DONE
    while abs((await client.joints())[0] - start[0]) > ROUNDING:
        await cell.clock.sleep(0.02)
    assert await client.ask("stopDirectServoJoints", replies=2) == DONE + DONE


async def test_a_push_on_the_tool_shows_in_forces_and_torques(cell: CellSimulation, client: KstClient) -> None:
    cell.world.arm.disturbance.push = 20.0
    try:
        await cell.clock.sleep(0.3)
        await at_rest(cell)
        force = np.array(await client.values("Eef_force"))
        torques = np.array(await client.values("Torques_ext_J"))
        joints = await client.joints()
    finally:
        cell.world.arm.disturbance.push = 0.0
    assert np.allclose(force, [0.0, 0.0, -20.0], atol=1.0)  # the tool's +z is the flange's -z
    expected = MODEL.jacobian(joints)[:3].T @ MODEL.forward(joints).rotation @ force
    assert np.allclose(torques, expected, atol=1.0)


async def test_end_ends_the_connection(client: KstClient) -> None:
    client.send("end")
    assert await client.until_closed() == b""


async def test_the_next_client_is_served_after_the_first_has_gone(cell: CellSimulation) -> None:
    async with serve_kst(cell, port=0) as (host, port):
        for _ in range(3):
            async with connected(host, port) as client:
                assert len(await client.joints()) == 7


async def test_an_arm_of_six_joints_has_no_such_cabinet() -> None:
    async with running_cell({"robot": {"driver": "kst", "model": "ur5"}}, SystemClock()) as cell:
        with pytest.raises(ConfigurationError, match="7 joints"):
            async with serve_kst(cell, port=0):
                pass
