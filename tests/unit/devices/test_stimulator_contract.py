"""What every driver of a stimulator does, whatever it drives."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from typing import Any

import pytest

from pcmrs.errors import DeviceError
from pcmrs.messages import StimulatorState
from tests.unit.devices.contract_stimulators import STIMULATORS, Bench, next_event

LONG = 60.0  # s; both drivers disarm after a minute, unless configured otherwise

CHARGING = 1.0


@pytest.fixture(params=STIMULATORS)
async def bench(request: pytest.FixtureRequest) -> AsyncIterator[Bench]:
    async with STIMULATORS[request.param]() as bench:
        yield bench


async def finished(bench: Bench, work: Coroutine[Any, Any, StimulatorState]) -> StimulatorState:
    task = asyncio.create_task(work)
    await bench.wait(0.0)
    await bench.wait(CHARGING)
    return await task


async def armed(bench: Bench) -> StimulatorState:
    return await finished(bench, bench.stimulator.arm())


async def test_it_starts_disarmed(bench: Bench) -> None:
    state = await bench.stimulator.state()
    assert (state.armed, state.ready, state.pulse) == (False, False, 0)


async def test_a_disarmed_one_never_fires(bench: Bench) -> None:
    with pytest.raises(DeviceError, match="not armed"):
        await bench.stimulator.fire(1)
    await armed(bench)
    await bench.stimulator.disarm()
    with pytest.raises(DeviceError, match="not armed"):
        await bench.stimulator.fire(1)
    assert (await bench.stimulator.state()).pulse == 0


async def test_an_armed_one_fires_what_was_set(bench: Bench) -> None:
    assert (await bench.stimulator.set_intensity(55.0)).intensity == 55.0
    state = await armed(bench)
    assert state.armed
    assert state.ready
    pulse = await bench.stimulator.fire(3)
    assert (pulse.number, pulse.intensity, pulse.fired) == (3, 55.0, bench.clock.monotonic())
    assert (await bench.stimulator.state()).pulse == 3


@pytest.mark.parametrize("number", [3, 2, 0, -1])
async def test_a_number_is_never_used_again(bench: Bench, number: int) -> None:
    await armed(bench)
    await bench.stimulator.fire(3)
    await bench.stimulator.disarm()
    await armed(bench)
    with pytest.raises(DeviceError, match="pulse 3 was given already"):
        await bench.stimulator.fire(number)
    assert (await bench.stimulator.fire(4)).number == 4


@pytest.mark.parametrize("percent", [-1.0, 100.5, float("nan"), float("inf")])
async def test_an_impossible_intensity_is_refused(bench: Bench, percent: float) -> None:
    await bench.stimulator.set_intensity(40.0)
    with pytest.raises(DeviceError, match="0 to 100"):
        await bench.stimulator.set_intensity(percent)
    assert (await bench.stimulator.state()).intensity == 40.0


async def test_it_disarms_by_itself_and_reports_it(bench: Bench) -> None:
    event = asyncio.create_task(next_event(bench.stimulator))
    await armed(bench)
    await bench.wait(LONG / 2)
    await bench.stimulator.fire(1)
    await bench.wait(LONG - 1.0)
    assert (await bench.stimulator.state()).armed
    assert not event.done()
    await bench.wait(1.5)
    assert not (await bench.stimulator.state()).armed
    assert ((await event).device, (await event).code, (await event).danger) == ("stimulator", "disarmed", False)
    with pytest.raises(DeviceError, match="not armed"):
        await bench.stimulator.fire(2)


async def test_disarming_as_asked_is_no_event(bench: Bench) -> None:
    event = asyncio.create_task(next_event(bench.stimulator))
    await armed(bench)
    await bench.stimulator.disarm()
    await bench.wait(2 * LONG)
    assert not event.done()
    event.cancel()
