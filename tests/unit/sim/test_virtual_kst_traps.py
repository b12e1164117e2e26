"""The traps of the cabinet: what stays unanswered, what cannot be stopped, who must wait, how replies arrive."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress

import numpy as np
import pytest
import pytest_asyncio

from pcmrs.clock import SystemClock
from pcmrs_sim.cell import CellSimulation, running_cell
from pcmrs_sim.faults import inject
from pcmrs_sim.kst.destination import LARGEST_JUMP
from pcmrs_sim.kst.server import serve_kst
from tests.unit.sim.kst_client import DEADLINE, KstClient, at_rest, client_of, connected, line

pytestmark = pytest.mark.asyncio(loop_scope="module")

DONE, NAK = b"done\n", b"nak\n"
ROUNDING = 6e-5  # rad


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def cell() -> AsyncIterator[CellSimulation]:
    async with running_cell({"robot": {"driver": "kst"}}, SystemClock()) as cell:
        yield cell


@pytest_asyncio.fixture(loop_scope="module")
async def client(cell: CellSimulation) -> AsyncIterator[KstClient]:
    await at_rest(cell)
    async with client_of(cell) as client:
        yield client


@pytest.mark.parametrize("trap", ["getJointPositions", "doPTPinCSRelBase", "velJDC_0_0_0_0_0_0_0_", "", "jp_1_x_", "ä"])
async def test_after_an_unknown_command_nothing_is_answered(client: KstClient, trap: str) -> None:
    assert await client.ask("jRelVel_0.2_") == DONE
    client.send(trap, "getJointsPositions", "Eef_pos", "jRelVel_0.2_", "startDirectServoJoints")
    assert await client.rest() == b""


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


@pytest.mark.parametrize("joint_2", [LARGEST_JUMP * 1.1, 3.0])
async def test_a_set_point_too_far_away_ends_the_servo(cell: CellSimulation, client: KstClient, joint_2: float) -> None:
    start = np.array(await client.joints())
    assert await client.ask("startDirectServoJoints") == DONE
    wrong = start.copy()
    wrong[1] += joint_2
    client.send(line("jf", wrong))
    assert await client.reply() == NAK
    await at_rest(cell)
    assert np.allclose(await client.joints(), start, atol=ROUNDING)
    assert await client.ask("startDirectServoJoints") == DONE


async def test_the_arm_brakes_when_its_client_goes(cell: CellSimulation) -> None:
    async with serve_kst(cell, port=0) as (host, port):
        async with connected(host, port) as client:
            start = np.array(await client.joints())
            goal = start.copy()
            goal[0] -= 0.5
            await client.ask("jRelVel_0.3_")
            await client.ask(line("jp", goal))
            assert await client.ask("doPTPinJS") == DONE
            while abs((await client.joints())[0] - start[0]) < 0.02:
                await cell.clock.sleep(0.01)
        async with connected(host, port) as client:
            await at_rest(cell)
            assert (await client.joints())[0] > goal[0] + 0.2


async def test_a_second_client_waits_until_the_first_has_gone(cell: CellSimulation) -> None:
    async with serve_kst(cell, port=0) as (host, port), connected(host, port) as first, connected(host, port) as second:
        waiting = asyncio.create_task(second.ask("getJointsPositions"))
        for _ in range(20):
            assert len(await first.joints()) == 7
        assert not waiting.done()
        first.close()
        assert len((await waiting).split(b"_")) == 8


async def test_late_client_is_refused_until_the_application_restarts(cell: CellSimulation) -> None:
    async with serve_kst(cell, port=0, accept_timeout=0.05) as (host, port):
        async with asyncio.timeout(DEADLINE):
            with suppress(ConnectionRefusedError):
                while True:
                    await cell.clock.sleep(0.2)
                    async with connected(host, port):
                        pass
        inject(cell, "restart_cabinet", {})
        async with asyncio.timeout(DEADLINE):
            while True:
                with suppress(ConnectionError):
                    async with connected(host, port) as client:
                        assert len(await client.joints()) == 7
                        break
                await cell.clock.sleep(0.01)
