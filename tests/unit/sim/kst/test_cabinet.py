"""Lines that the virtual cabinet does not know, and lines of any kind."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ARMS
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.cabinet import INPUTS, OUTPUTS, SET_POINTS, SimulatedCabinet
from pcmrs_sim.kst.main_loop import NOT_SIMULATED, QUERIES
from pcmrs_sim.settings import SimSettings
from tests.support.trials import examples
from tests.unit.sim.kst_client import DONE, NAK, KstClient

LOOP = pytest.mark.asyncio(loop_scope="module")


@LOOP
@pytest.mark.parametrize("skipped", ["", "getJointPositions", "jf", "DcSeCarW_1.0_2.0_3.0_0_0_0_", "velocity", "ä"])
async def test_an_empty_or_unknown_line_is_skipped(client: KstClient, skipped: str) -> None:
    client.send(skipped, "jRelVel_0.2_")
    assert await client.reply() == DONE
    assert len(await client.joints()) == 7


@LOOP
@pytest.mark.parametrize("trap", ["jp_1_x_", "jf_x_", "cArtixanPosition_x_"])
async def test_targets_that_are_no_numbers_end_the_reader(client: KstClient, trap: str) -> None:
    client.send(trap, "getJointsPositions", "Eef_pos", "jRelVel_0.2_")
    assert await client.rest() == b""


@LOOP
async def test_lines_of_public_clients_end_with_two_newlines(client: KstClient) -> None:
    """The bytes of the toolbox's Python client for a motion to the present posture, and for a line of no length."""
    joints, pose = await client.joints(), await client.values("Eef_pos")
    client.raw(b"jRelVel_0.1_\n")
    assert await client.reply() == DONE
    client.raw(b"jp_" + "".join(f"{value}_" for value in joints).encode() + b"\n\n")
    assert await client.reply() == DONE
    client.raw(b"doPTPinJS\n")
    assert [await client.reply(), await client.reply()] == [DONE, DONE]
    client.raw(b"jRelVel_10_\n")
    assert await client.reply() == DONE
    client.raw(b"cArtixanPosition_" + "".join(f"{value}_" for value in pose).encode() + b"\n\n")
    assert await client.reply() == DONE
    client.raw(b"doPTPinCS\n")
    assert [await client.reply(), await client.reply()] == [DONE, DONE]
    client.raw(b"startDirectServoJoints\n")
    assert await client.reply() == DONE
    client.raw(b"jpJP_" + "".join(f"{value}_" for value in joints).encode() + b"\n\n")
    assert (await client.reply()).count(b"_") == 7
    client.raw(b"stopDirectServoJoints\n")
    assert await client.reply() == DONE


@LOOP
async def test_the_pins_of_the_flange_are_answered(client: KstClient) -> None:
    for request in OUTPUTS:
        assert await client.ask(request) == DONE, request
    for request in INPUTS:
        assert await client.ask(request, replies=2) == b"1\n\n", request


@LOOP
@pytest.mark.parametrize("request_", ["handGuiding_", "preciseHandGuiding1_1.0_0_0_0", "doPTP!inJS_1_-5_5_"])
async def test_what_is_not_simulated_is_a_nak(client: KstClient, request_: str) -> None:
    assert await client.ask(request_) == NAK


REQUESTS = (
    *SET_POINTS,
    *QUERIES,
    *OUTPUTS,
    *INPUTS,
    *NOT_SIMULATED,
    "TFtrans_",
    "jRelVel_",
    "doPTPinJS",
    "doPTPinCS",
    "doPTPinCSRelEEF",
    "doPTPinCSRelBase",
    "doPTPinCSCircle1",
    "startDirectServoJoints",
    "stDcEEf_",
    "stVelDcJoint_",
    "startSmartImpedneceJoints_",
    "stopDirectServoJoints",
    "getJointsPositions",
)
numbers = st.lists(st.floats(allow_nan=False).map(repr) | st.floats(-4.0, 4.0).map(repr), max_size=8)
requests = st.builds(lambda name, words: name + "_".join(words), st.sampled_from(REQUESTS), numbers)
anything = st.text(st.characters(max_codepoint=255, exclude_characters="\n"), max_size=40)


@pytest.fixture(scope="module")
def still_cell() -> CellSimulation:
    return CellSimulation(SimSettings(), ARMS["iiwa14"], ForceSettings(force_limit=math.inf), SystemClock())


@examples(60)
@given(lines=st.lists(requests | anything, max_size=8))
def test_the_cabinet_survives_any_requests(still_cell: CellSimulation, lines: list[str]) -> None:
    answers: list[str] = []
    cabinet = SimulatedCabinet(still_cell, answers.append, lambda: None)
    with np.errstate(over="ignore", invalid="ignore"):  # a tool frame may be as far away as numbers go
        for line in lines:
            cabinet.receive(line)
            cabinet.update()
    cabinet.leave()
    assert all(answer.isascii() for answer in answers)
