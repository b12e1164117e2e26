"""When the robot counts as lost."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from pcmrs.devices.deadman import DEADMAN, beat_period
from pcmrs.messages import DeviceEvent
from pcmrs.service.watches.robot import BEATS_MISSED, HELD_UP, SILENCE, RobotWatch
from pcmrs.testing.clock import ManualClock, settle

BEAT_PERIOD = beat_period(DEADMAN)


class Bench:
    def __init__(self) -> None:
        self.clock = ManualClock()
        self.connected = True
        self.events: list[DeviceEvent] = []
        self.beats: list[float] = []
        self.reporting = asyncio.Event()
        self.reporting.set()
        self.watch = RobotWatch(self.beats.append, lambda: self.connected, lambda: False, self._report, self.clock)

    async def _report(self, event: DeviceEvent) -> None:
        self.events.append(event)
        await self.reporting.wait()
        self.connected = False


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    running = asyncio.create_task(made.watch.run())
    yield made
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


async def _hear_for(bench: Bench, seconds: float, *, beats: bool = True, joints: bool = True) -> None:
    for _ in range(round(seconds / BEAT_PERIOD)):
        if joints:
            bench.watch.record_joints()
        if beats:
            bench.watch.record_beat(bench.clock.monotonic())
        await bench.clock.advance(BEAT_PERIOD)


async def test_it_beats_while_the_robot_reports(bench: Bench) -> None:
    await _hear_for(bench, 5.0)
    assert bench.beats == pytest.approx([bench.beats[0] + BEAT_PERIOD * number for number in range(len(bench.beats))])
    assert len(bench.beats) == pytest.approx(5.0 / BEAT_PERIOD, abs=2)
    assert bench.events == []


async def test_a_silent_robot_is_lost_once(bench: Bench) -> None:
    await _hear_for(bench, 1.0)
    await _hear_for(bench, SILENCE + 2 * BEAT_PERIOD, joints=False)
    (event,) = bench.events
    assert (event.device, event.code, event.danger) == ("robot", "link_lost", True)
    assert "reported its joints" in event.text
    await bench.clock.advance(10.0)
    assert len(bench.events) == 1


async def test_node_without_a_heartbeat_is_lost_even_if_joints_come(bench: Bench) -> None:
    await _hear_for(bench, 1.0)
    await _hear_for(bench, BEATS_MISSED * DEADMAN + 2 * BEAT_PERIOD, beats=False)
    (event,) = bench.events
    assert (event.code, event.danger) == ("link_lost", True)
    assert "heartbeat" in event.text


async def test_delayed_watch_first_takes_what_has_arrived(bench: Bench) -> None:
    await _hear_for(bench, 1.0)
    bench.clock.stall(10 * SILENCE)
    await bench.clock.advance(HELD_UP / 10)
    await _hear_for(bench, 1.0)
    assert bench.events == []


async def test_a_robot_that_is_not_connected_may_be_silent(bench: Bench) -> None:
    bench.connected = False
    await bench.clock.advance(10.0)
    await bench.watch.lose("Its node has ended.")
    assert bench.events == []


async def test_node_gets_no_beat_while_a_loss_is_handled_and_holds(bench: Bench) -> None:
    """The node holds, too."""
    bench.reporting.clear()
    await bench.clock.advance(SILENCE + 2 * BEAT_PERIOD)
    assert len(bench.events) == 1
    before = len(bench.beats)
    await bench.clock.advance(1.0)
    assert len(bench.beats) == before
    bench.reporting.set()
    await settle()
    await bench.clock.advance(1.0)
    assert len(bench.beats) > before


async def test_a_late_heartbeat_of_the_node_is_no_life_of_now(bench: Bench) -> None:
    await _hear_for(bench, 1.0)
    last = bench.clock.monotonic()
    for _ in range(round((BEATS_MISSED * DEADMAN + 2 * BEAT_PERIOD) / BEAT_PERIOD)):
        bench.watch.record_joints()
        bench.watch.record_beat(last)  # they were delayed, and arrive one after the other
        await bench.clock.advance(BEAT_PERIOD)
    assert [event.code for event in bench.events] == ["link_lost"]
