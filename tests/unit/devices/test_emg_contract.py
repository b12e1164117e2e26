"""What every driver of an electromyograph does, whatever it reads from."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import numpy as np
import pytest

from pcmrs.errors import DeviceError
from pcmrs.messages import Epoch
from pcmrs.spatial import Floats
from tests.unit.devices.contract_emgs import EMGS, QUIET, Lab
from tests.unit.devices.lsl_lab import PATIENCE

FIRST = 5000  # of the pulses of these tests; connecting takes some before


@pytest.fixture(params=EMGS)
async def lab(request: pytest.FixtureRequest) -> AsyncIterator[Lab]:
    async with EMGS[request.param]() as lab:
        yield lab


def times(epoch: Epoch) -> Floats:
    return epoch.start + np.arange(len(epoch.samples)) / epoch.rate_hz


def peak_to_peak(epoch: Epoch) -> float:
    """Where the response is expected, without the artefact."""
    within = (times(epoch) > 0.015) & (times(epoch) < 0.05)
    return float(np.ptp(np.array(epoch.samples)[within]))


async def test_an_epoch_shows_artefact_and_response_where_they_belong(lab: Lab) -> None:
    for number in range(FIRST, FIRST + 3):
        lab.fire(number, 1.3 * lab.threshold)
        epoch = await lab.emg.epoch(number, 0.1, 0.1)
        assert (epoch.pulse, epoch.muscle, epoch.rate_hz) == (number, "FDI", QUIET.rate_hz)
        assert epoch.full_scale == pytest.approx(50e-3)
        assert len(epoch.samples) == pytest.approx(0.2 * QUIET.rate_hz, abs=2)
        assert epoch.start == pytest.approx(-0.1, abs=2 / QUIET.rate_hz)
        artefact = times(epoch)[np.argmax(epoch.samples)]
        assert 0.0 <= artefact + 1e-4 < 2 / QUIET.rate_hz + 1e-4  # on a sample, so up to one late
        stimulus = lab.muscle.stimulus(number)
        assert stimulus is not None
        assert stimulus.intensity == pytest.approx(1.3 * lab.threshold)
        assert peak_to_peak(epoch) == pytest.approx(stimulus.amplitude, abs=12e-6)


async def test_an_epoch_may_be_asked_for_before_its_pulse(lab: Lab) -> None:
    asked = asyncio.create_task(lab.emg.epoch(FIRST, 0.05, 0.05))
    await asyncio.sleep(0)
    lab.fire(FIRST, 50.0)
    assert (await asked).pulse == FIRST


async def test_a_pulse_that_was_not_given_has_no_epoch(lab: Lab) -> None:
    async with asyncio.timeout(PATIENCE):
        with pytest.raises(DeviceError, match=f"Pulse {FIRST} has no epoch"):
            await lab.emg.epoch(FIRST, 0.05, 0.05)


async def test_without_a_response_there_is_only_noise(lab: Lab) -> None:
    lab.muscle.silent = True
    lab.fire(FIRST, 2.0 * lab.threshold)
    assert peak_to_peak(await lab.emg.epoch(FIRST, 0.05, 0.06)) < 20e-6


async def test_an_impossible_window_is_refused(lab: Lab) -> None:
    with pytest.raises(DeviceError, match="range of both is 0 to 5 s"):
        await lab.emg.epoch(FIRST, 0.05, -1.0)
