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
from pcmrs_sim.kst.cabinet import SET_POINTS, SimulatedCabinet
from pcmrs_sim.kst.main_loop import QUERIES
from pcmrs_sim.settings import SimSettings
from tests.support.trials import examples
from tests.unit.sim.kst_client import DONE, KstClient


@pytest.mark.asyncio(loop_scope="module")
@pytest.mark.parametrize("trap", ["getJointPositions", "doPTPinCSRelBase", "velJDC_0_0_0_0_0_0_0_", "", "jp_1_x_", "ä"])
async def test_after_an_unknown_command_nothing_is_answered(client: KstClient, trap: str) -> None:
    assert await client.ask("jRelVel_0.2_") == DONE
    client.send(trap, "getJointsPositions", "Eef_pos", "jRelVel_0.2_", "startDirectServoJoints")
    assert await client.rest() == b""


REQUESTS = (
    *(f"{name}_" for name in SET_POINTS),
    *QUERIES,
    "TFtrans_",
    "jRelVel_",
    "cArtixanPosition_",
    "doPTPinJS",
    "doPTPinCS",
    "startDirectServoJoints",
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
