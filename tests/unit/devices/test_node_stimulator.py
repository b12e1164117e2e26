"""A stimulator behind its node: typed calls, and disarmed whenever nobody watches over it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress

import pytest

from pcmrs.devices.deadman import DEADMAN, beat_period
from pcmrs.devices.node import DAEMON_BEAT, PULSE_DELAY, DeviceNode
from pcmrs.devices.remote import RemoteEmg, RemoteStimulator
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import Beat, DeviceEvent, FiredPulse, NodeBeat
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.testing.devices import EPOCH, FakeEmg, FakeStimulator
from tests.support.memory_link import MemoryLink

BEAT_PERIOD = beat_period(DEADMAN)


class Bench:
    def __init__(self) -> None:
        self.clock = ManualClock()
        self.link = MemoryLink()
        self.device = FakeStimulator()
        self.node = DeviceNode(self.link, {"stimulator": self.device, "emg": FakeEmg()}, self.clock)
        self.stimulator = RemoteStimulator(self.link, self.clock, "a")
        self.emg = RemoteEmg(self.link, self.clock)


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    bench = Bench()
    serving = asyncio.create_task(bench.node.run())
    await settle()
    await bench.stimulator.state()
    await bench.stimulator.release_latch()
    yield bench
    serving.cancel()
    with suppress(asyncio.CancelledError):
        await serving


async def test_pulses_and_epochs_keep_their_types(bench: Bench) -> None:
    assert (await bench.stimulator.arm()).armed
    assert await bench.stimulator.fire(1) == FiredPulse(number=1, intensity=50.0, fired=1.0)
    assert await bench.emg.epoch(1, 0.1, 0.1) == EPOCH
    with pytest.raises(DeviceError, match="No marker of pulse 2"):
        await bench.emg.epoch(2, 0.1, 0.1)


async def test_a_pulse_that_nobody_answers_for_is_unknown_not_failed(bench: Bench) -> None:
    bench.link.silent = True
    with pytest.raises(UnknownOutcomeError):
        await bench.stimulator.fire(1)


async def test_stop_disarms_by_the_node_itself(bench: Bench) -> None:
    await bench.stimulator.arm()
    bench.node.stop("bus:nurse")
    await settle()
    assert not bench.device.armed


def hear_daemon(bench: Bench, number: int) -> None:
    now = bench.clock.monotonic()
    bench.link.hear(DAEMON_BEAT, Beat(number=number, session="a", alive=now, sent=now))


async def test_armed_stimulator_is_disarmed_when_daemon_falls_silent(bench: Bench) -> None:
    await bench.stimulator.arm()
    for number in range(1, 20):
        hear_daemon(bench, number)
        await bench.clock.advance(BEAT_PERIOD)
    assert bench.device.disarms == 0
    await bench.clock.advance(DEADMAN + BEAT_PERIOD)
    assert bench.device.disarms == 1
    (silent,) = bench.link.published["dev/stimulator/event"]
    assert silent.code == "daemon_silent"
    assert "dev/robot/event" not in bench.link.published, "there is no robot that could move"
    await bench.clock.advance(10.0)
    assert bench.device.disarms == 1, "one that is not armed is left alone"


async def test_the_beats_of_another_node_are_not_those_of_the_daemon(bench: Bench) -> None:
    await bench.stimulator.arm()
    for number in range(10):  # of the robot's node, which has outlived the daemon
        bench.link.hear("dev/robot/beat", NodeBeat(number=number, sent=bench.clock.monotonic()))
        await bench.clock.advance(BEAT_PERIOD)
    assert bench.device.disarms == 1


async def test_pulse_that_waited_for_a_delayed_node_is_not_given_late(bench: Bench) -> None:
    await bench.stimulator.arm()
    bench.clock.stall(PULSE_DELAY + 0.1)
    for number in (1, 2):  # whether the beats of the node come first or the request
        hear_daemon(bench, number)
        with pytest.raises(DeviceError, match="held up"):
            await bench.stimulator.fire(1)
        await bench.clock.advance(BEAT_PERIOD)
    assert bench.device.pulse == 0
    for number in range(3, 4 + round(PULSE_DELAY / BEAT_PERIOD)):
        hear_daemon(bench, number)
        await bench.clock.advance(BEAT_PERIOD)
    await bench.stimulator.fire(1)
    assert bench.device.pulse == 1


async def test_stimulator_that_does_not_report_its_state_is_disarmed(bench: Bench) -> None:
    bench.device.error = OSError("The cable is out.")
    for disarms in (1, 2):
        await bench.clock.advance(DEADMAN + BEAT_PERIOD / 2)
        assert bench.device.disarms == disarms


async def test_its_events_are_published(bench: Bench) -> None:
    event = DeviceEvent(device="stimulator", code="disarmed", text="The coil is too hot.")
    bench.device.reports.put_nowait(event)
    await settle()
    assert bench.link.published["dev/stimulator/event"] == [event]
