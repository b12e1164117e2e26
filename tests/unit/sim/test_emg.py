"""Epochs of the simulated electromyograph: their window, their samples, and pulses that were not given."""

import asyncio

import numpy as np
import pytest

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.protocols import Emg
from pcmrs.errors import DeviceError
from pcmrs.kinematics.arms import ARMS
from pcmrs.testing.clock import ManualClock, settle
from pcmrs_sim.emg import GRACE, SimEmg
from pcmrs_sim.settings import SimSettings
from pcmrs_sim.world import World

DRIVER: type[Emg] = SimEmg  # the type checker proves it


def make_world(clock: ManualClock) -> World:
    return World(SimSettings(), ARMS["iiwa14"], ForceSettings(), clock.monotonic())


async def test_epoch_holds_the_samples_around_the_pulse() -> None:
    clock = ManualClock()
    world = make_world(clock)
    fired = clock.monotonic() + 0.00013  # between two samples
    world.stimulate(4, 60.0, fired)
    taking = asyncio.create_task(SimEmg(world, clock).epoch(4, 0.05, 0.06))
    await settle()
    await clock.advance(0.06)
    assert not taking.done(), "the last sample has not been taken yet"
    await clock.advance(0.001)
    epoch = await taking
    times = fired + epoch.start + np.arange(len(epoch.samples)) / epoch.rate_hz
    assert times[0] >= fired - 0.05 > times[0] - 1 / epoch.rate_hz
    assert times[-1] <= fired + 0.06 < times[-1] + 1 / epoch.rate_hz
    numbers = np.rint(times * epoch.rate_hz)
    assert times * epoch.rate_hz == pytest.approx(numbers, abs=1e-6), "samples lie on the amplifier's grid"
    assert epoch.samples == world.muscle.samples(int(numbers[0]), len(numbers)).tolist()
    assert epoch.full_scale == pytest.approx(0.010)


async def test_epoch_of_a_pulse_that_comes_later_waits_for_it() -> None:
    clock = ManualClock()
    world = make_world(clock)
    taking = asyncio.create_task(SimEmg(world, clock).epoch(7, 0.01, 0.02))
    await settle()
    await clock.advance(0.3)
    world.stimulate(7, 60.0, clock.monotonic())
    await clock.advance(0.1)
    assert (await taking).pulse == 7


async def test_epoch_of_a_pulse_that_was_not_given_is_an_error() -> None:
    clock = ManualClock()
    taking = asyncio.create_task(SimEmg(make_world(clock), clock).epoch(7, 0.01, 0.02))
    await settle()
    await clock.advance(0.02 + GRACE - 0.02)
    assert not taking.done()
    await clock.advance(0.05)
    with pytest.raises(DeviceError, match="Pulse 7 has no epoch") as refused:
        await taking
    assert refused.value.fields == {"pulse": 7}


@pytest.mark.parametrize(("before", "after"), [(-0.01, 0.1), (0.1, float("nan")), (0.1, 60.0)])
async def test_a_window_that_is_impossible_is_refused_at_once(before: float, after: float) -> None:
    clock = ManualClock()
    with pytest.raises(DeviceError, match="is not possible"):
        await SimEmg(make_world(clock), clock).epoch(1, before, after)
