"""Faults of the simulated muscle."""

from collections.abc import AsyncIterator

import pytest

from pcmrs.errors import DeviceError
from pcmrs.testing.clock import ManualClock
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.faults import inject
from tests.unit.sim.stimulator_cell import make_cell, stimulator_of


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
async def cell(clock: ManualClock) -> AsyncIterator[CellSimulation]:
    cell = make_cell(clock)
    yield cell
    stimulator_of(cell).close()


async def test_faults_of_the_muscle_can_be_injected(cell: CellSimulation) -> None:
    inject(cell, "no_mep", {})
    assert cell.world.muscle.silent
    inject(cell, "no_mep", {"on": False})
    assert not cell.world.muscle.silent
    inject(cell, "preactivation", {"microvolts": 80.0})
    rate = cell.world.settings.muscle.rate_hz
    first = round((cell.world.time + 1.0) * rate)
    assert cell.world.muscle.samples(first, rate).std() == pytest.approx(80e-6, rel=0.05)
    with pytest.raises(DeviceError, match="microvolts"):
        inject(cell, "preactivation", {"microvolts": -1.0})
