"""The simulated cell in the time of its clock."""

import asyncio

import pytest

from pcmrs.clock import Clock
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.errors import ConfigurationError
from pcmrs.kinematics.arms import ARMS
from pcmrs_sim.cell import LONGEST_CATCH_UP, CellSimulation
from pcmrs_sim.opening import open_devices
from pcmrs_sim.settings import SimSettings
from tests.unit.sim.cell_readings import next_frames


async def test_a_slow_machine_slows_the_cell_and_is_counted(clock: Clock) -> None:
    cell = CellSimulation(SimSettings(), ARMS["iiwa14"], ForceSettings(), clock)
    frames = asyncio.create_task(next_frames(cell.devices, 5))
    await asyncio.sleep(0)
    now = clock.monotonic()
    cell.advance(now + LONGEST_CATCH_UP + 3.0)
    assert cell.lag == pytest.approx(3.0)
    cell.advance(now + LONGEST_CATCH_UP + 3.05)
    captured = [frame[0].captured for frame in await frames]
    assert min(captured) >= now + 3.0


@pytest.mark.parametrize("key", ["home", "stiffness"])
async def test_settings_for_another_number_of_joints_are_refused(key: str, clock: Clock) -> None:
    settings = {"robot": {"model": "ur5"}, "sim": {"arm": {key: [1.0] * 7}}}
    with pytest.raises(ConfigurationError, match=rf"sim\.arm\.{key} holds 7 numbers; ur5 has 6 joints"):
        async with open_devices(("robot",), settings, clock):
            pass
