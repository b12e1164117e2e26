"""No line, whatever it holds, breaks the virtual cabinet or the faults of a simulated cell."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.errors import DeviceError
from pcmrs.kinematics.arms import ARMS
from tests.support.trials import examples

pytest.importorskip("mujoco")

from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.faults import FAULTS, inject, parse_fault
from pcmrs_sim.kst.cabinet import SET_POINTS, SimulatedCabinet
from pcmrs_sim.kst.main_loop import QUERIES
from pcmrs_sim.settings import SimSettings

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
def cell() -> CellSimulation:
    return CellSimulation(SimSettings(), ARMS["iiwa14"], ForceSettings(force_limit=math.inf), SystemClock())


@examples(60)
@given(lines=st.lists(requests | anything, max_size=8))
def test_the_cabinet_survives_any_requests(cell: CellSimulation, lines: list[str]) -> None:
    answers: list[str] = []
    cabinet = SimulatedCabinet(cell, answers.append, lambda: None)
    with np.errstate(over="ignore", invalid="ignore"):  # a tool frame may be as far away as numbers go
        for line in lines:
            cabinet.receive(line)
            cabinet.update()
    cabinet.leave()
    assert all(answer.isascii() for answer in answers)


@settings(deadline=None)
@given(
    st.builds(" ".join, st.tuples(st.sampled_from(sorted(FAULTS)), st.text(max_size=20))) | st.text(max_size=40),
)
def test_a_line_is_a_fault_or_is_refused(cell: CellSimulation, line: str) -> None:
    if not line.strip():
        return  # such lines are passed over
    with suppress(DeviceError):
        inject(cell, *parse_fault(line))
