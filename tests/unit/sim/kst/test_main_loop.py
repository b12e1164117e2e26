"""Motions and servo sessions of the virtual cabinet, byte by byte over a real socket."""

import re

import numpy as np
import pytest

from pcmrs_sim.cell import CellSimulation
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
