"""Motions and servo sessions of the virtual cabinet, byte by byte over a real socket."""

import re

import numpy as np
import pytest

from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.readings import from_xyzabc
from tests.unit.sim.kst_client import (
    DONE,
    NUMBER,
    ROUNDING,
    KstClient,
    line,
)
from tests.unit.sim.simulated_arms import HOME

pytestmark = pytest.mark.asyncio(loop_scope="module")


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


async def test_the_main_loop_answers_nothing_while_a_servo_lasts(client: KstClient) -> None:
    joints = await client.joints()
    assert await client.ask("startDirectServoJoints") == DONE
    client.send("Eef_pos", "Torques_ext_J", "jRelVel_0.1_", line("jp", joints), "stopDirectServoJoints")
    assert await client.rest() == DONE + DONE


async def test_point_to_point_motion_cannot_be_stopped(client: KstClient) -> None:
    """It swallows what is sent meanwhile."""
    goal = np.array(await client.joints())
    goal[0] += 0.1
    assert await client.ask("jRelVel_0.2_") == DONE
    assert await client.ask(line("jp", goal)) == DONE
    assert await client.ask("doPTPinJS") == DONE
    assert await client.ask("stopDirectServoJoints") == DONE
    assert len(await client.joints()) == 7  # this is answered while it moves
    client.send("doPTPinJS")
    assert await client.reply() == DONE
    assert np.allclose(await client.joints(), goal, atol=ROUNDING)


async def test_a_relative_motion_in_the_base_keeps_the_angles(client: KstClient) -> None:
    assert await client.ask("TFtrans_0_0_150_0_0_0") == DONE
    before = await client.values("Eef_pos")
    assert await client.ask("jRelVel_60_") == DONE
    assert await client.ask("cArtixanPosition_0_10.0_15.0_0_0_0_") == DONE
    assert await client.ask("doPTPinCSRelBase", replies=2) == DONE + DONE
    after = np.array(await client.values("Eef_pos"))
    assert np.allclose(after[:3], np.add(before[:3], (0.0, 10.0, 15.0)), atol=0.1)
    assert np.allclose(np.cos(after[3:]), np.cos(before[3:]), atol=1e-3)


async def test_a_relative_motion_in_the_tool_goes_along_its_axes(client: KstClient) -> None:
    assert await client.ask("TFtrans_0_0_150_0_0_0") == DONE
    before = from_xyzabc(await client.values("Eef_pos"))
    assert await client.ask("jRelVel_60_") == DONE
    assert await client.ask("cArtixanPosition_0_0_-12.0_0_0_0_") == DONE
    assert await client.ask("doPTPinCSRelEEF", replies=2) == DONE + DONE
    way = before.inverse() @ from_xyzabc(await client.values("Eef_pos"))
    assert np.allclose(way.translation, (0.0, 0.0, -0.012), atol=1e-4)


async def test_a_circle_ends_at_its_second_frame(client: KstClient) -> None:
    pose = await client.values("Eef_pos")
    middle, end = list(pose), list(pose)
    middle[0], middle[2] = pose[0] + 15.0, pose[2] + 15.0
    end[2] = pose[2] + 30.0
    assert await client.ask("jRelVel_60_") == DONE
    client.raw(line("cArtixanPositionCirc1", middle).encode() + b"\n\n")
    client.raw(line("cArtixanPositionCirc2", end).encode() + b"\n\n")
    assert [await client.reply(), await client.reply()] == [DONE, DONE]
    assert await client.ask("doPTPinCSCircle1_", replies=2) == DONE + DONE
    assert np.allclose((await client.values("Eef_pos"))[:3], end[:3], atol=0.1)


async def test_a_circle_through_places_on_a_line_is_a_nak(client: KstClient) -> None:
    pose = await client.values("Eef_pos")
    assert await client.ask("jRelVel_60_") == DONE
    assert await client.ask(line("cArtixanPositionCirc1", pose)) == DONE
    assert await client.ask(line("cArtixanPositionCirc2", pose)) == DONE
    assert await client.ask("doPTPinCSCircle1_", replies=2) == DONE + b"nak\n"


async def test_a_servo_of_the_tool_goes_to_its_last_pose(cell: CellSimulation, client: KstClient) -> None:
    assert await client.ask("TFtrans_0_0_150_0_0_0") == DONE
    pose = await client.values("Eef_pos")
    assert await client.ask("stDcEEf_") == DONE
    for _ in range(10):
        pose[2] -= 1.0
        client.raw(line("DcSeCar", pose).encode() + b"\n\n")  # no reply
        await cell.clock.sleep(0.005)
    assert len(await client.values(line("DcSeCarJP", pose))) == 7
    for answered in ("DcSeCarExT", "DcSeCarMT"):
        assert len(await client.values(line(answered, pose))) == 7
    assert len(await client.values(line("DcSeCarEEfP", pose))) == 3
    await settled(cell, client)
    assert await client.ask("stopDirectServoJoints") == DONE
    assert np.allclose((await client.values("Eef_pos"))[:3], pose[:3], atol=0.1)


@pytest.mark.parametrize(
    ("begin", "far"),
    [
        ("stDcEEf_", "DcSeCar_2000.0_0.0_500.0_0_0_0_"),
        ("stDcEEf_", "DcSeCar_2e7_0.0_500.0_0_0_0_"),
        ("stVelDcJoint_", "velJDC_99.0_0_0_0_0_0_0_"),
    ],
)
async def test_a_servo_ends_at_a_set_point_it_cannot_follow(client: KstClient, begin: str, far: str) -> None:
    assert await client.ask(begin) == DONE
    client.send(far)
    replies = {await client.reply() for _ in range(2 if far.startswith("vel") else 1)}
    assert b"nak\n" in replies
    assert await client.ask("startDirectServoJoints") == DONE
    assert await client.ask("stopDirectServoJoints") == DONE


async def test_wrong_numbers_end_a_servo_and_not_the_reader(client: KstClient) -> None:
    assert await client.ask("stVelDcJoint_") == DONE
    assert await client.ask("velJDC_x_0_0_0_0_0_0_") == DONE
    assert len(await client.values("Torques_m_J")) == 7, "the main loop is free again"


async def test_a_servo_of_velocities_turns_a_joint_until_it_stops(cell: CellSimulation, client: KstClient) -> None:
    start = np.array(await client.joints())
    assert await client.ask("stVelDcJoint_") == DONE
    assert await client.ask("velJDC_0_0_0_0_0_0_0.2_") == DONE
    while (await client.joints())[6] - start[6] < 0.05:
        await cell.clock.sleep(0.01)
    assert len(await client.values("velJDCJP_0_0_0_0_0_0_0.0_")) == 7
    for answered in ("velJDCExT", "velJDCMT"):
        assert len(await client.values(line(answered, [0.0] * 7))) == 7
    assert len(await client.values(line("velJDCEEfP", [0.0] * 7))) == 3
    await settled(cell, client)
    assert await client.ask("stopDirectServoJoints") == DONE
    end = np.array(await client.joints())
    assert np.allclose(end[:6], start[:6], atol=ROUNDING)
    assert end[6] - start[6] < 0.5


async def settled(cell: CellSimulation, client: KstClient) -> None:
    """Return when the joints no longer change."""
    before, now = np.zeros(7), np.array(await client.joints())
    while np.abs(now - before).max() > ROUNDING / 10.0:
        await cell.clock.sleep(0.05)
        before, now = now, np.array(await client.joints())
