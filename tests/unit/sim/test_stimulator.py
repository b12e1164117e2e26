"""The simulated stimulator: it charges, heats and disarms itself."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import aclosing

import pytest

from pcmrs.devices.protocols import StimulatorDriver
from pcmrs.errors import DeviceError
from pcmrs.messages import DeviceEvent
from pcmrs.testing.clock import ManualClock, settle
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.stimulator import SimStimulator
from tests.unit.sim.stimulator_cell import make_cell, stimulator_of

DRIVER: type[StimulatorDriver] = SimStimulator  # the type checker proves it


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
async def cell(clock: ManualClock) -> AsyncIterator[CellSimulation]:
    cell = make_cell(clock)
    yield cell
    stimulator_of(cell).close()


async def armed(cell: CellSimulation, clock: ManualClock) -> SimStimulator:
    stimulator = stimulator_of(cell)
    arming = asyncio.create_task(stimulator.arm())
    await settle()
    await clock.advance(1.0)
    await arming
    return stimulator


async def next_event(stimulator: SimStimulator) -> DeviceEvent:
    async with aclosing(stimulator.events()) as events:  # type: ignore[type-var]
        return await anext(events)


async def test_it_charges_before_it_is_armed(cell: CellSimulation, clock: ManualClock) -> None:
    stimulator = stimulator_of(cell)
    arming = asyncio.create_task(stimulator.arm())
    await settle()
    await clock.advance(0.9)
    assert not (await stimulator.state()).armed
    with pytest.raises(DeviceError, match="not armed"):
        await stimulator.fire(1)
    await clock.advance(0.2)
    assert (await arming).ready


async def test_it_is_disarmed_at_once_while_it_charges(cell: CellSimulation, clock: ManualClock) -> None:
    stimulator = stimulator_of(cell)
    arming = asyncio.create_task(stimulator.arm())
    await settle()
    assert not (await stimulator.disarm()).armed
    await clock.advance(5.0)
    with pytest.raises(DeviceError, match="while it charged"):
        await arming
    assert not (await stimulator.state()).armed


async def test_it_recharges_after_a_pulse(cell: CellSimulation, clock: ManualClock) -> None:
    stimulator = await armed(cell, clock)
    await stimulator.fire(1)
    assert not (await stimulator.state()).ready
    with pytest.raises(DeviceError, match=r"ready in 0\.50 s"):
        await stimulator.fire(2)
    assert (await stimulator.state()).pulse == 1
    await clock.advance(0.5)
    assert (await stimulator.fire(2)).number == 2


async def test_a_hot_coil_disarms_until_it_has_cooled(clock: ManualClock) -> None:
    cell = make_cell(clock, heat=10.0, cooling_time=100.0)
    stimulator = await armed(cell, clock)
    event = asyncio.create_task(next_event(stimulator))
    await settle()
    await stimulator.set_intensity(100.0)
    await stimulator.fire(1)
    temperature = (await stimulator.state()).coil_temperature
    assert temperature == pytest.approx(32.0)
    await clock.advance(0.5)
    await stimulator.fire(2)
    assert (await event).text.startswith("The coil is at 42.0 degrees Celsius")
    assert not (await stimulator.state()).armed
    with pytest.raises(DeviceError, match="let it cool"):
        await stimulator.arm()
    await clock.advance(30.0)
    await armed(cell, clock)
    stimulator.close()


async def test_heat_goes_with_the_square_of_the_intensity(cell: CellSimulation, clock: ManualClock) -> None:
    stimulator = await armed(cell, clock)
    await stimulator.set_intensity(50.0)
    await stimulator.fire(1)
    assert (await stimulator.state()).coil_temperature == pytest.approx(22.0 + 0.08 / 4)


async def test_a_pulse_reaches_the_muscle_of_the_world(cell: CellSimulation, clock: ManualClock) -> None:
    stimulator = await armed(cell, clock)
    await stimulator.set_intensity(66.0)
    pulse = await stimulator.fire(9)
    felt = cell.world.muscle.stimulus(9)
    assert felt is not None
    assert (felt.intensity, felt.time) == (66.0, pulse.fired)


async def test_it_disarms_by_itself_in_a_running_cell(cell: CellSimulation, clock: ManualClock) -> None:
    stimulator = await armed(cell, clock)
    cell.advance(clock.monotonic() + 59.0)
    assert (await stimulator.state()).armed
    cell.advance(clock.monotonic() + 60.0)
    assert not (await stimulator.state()).armed
