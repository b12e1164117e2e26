"""The node's own watch over the daemon: a moving arm is held when the daemon has been silent for too long."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import msgspec
import pytest

from pcmrs.devices.deadman import DEADMAN, DELIVERY, HELD_UP, TURN
from pcmrs.devices.node import DAEMON_BEAT
from pcmrs.errors import DeviceError
from pcmrs.messages import (
    Beat,
)
from pcmrs.testing.clock import settle
from pcmrs.testing.devices import STATE
from pcmrs.threads import Load
from tests.unit.devices.node_bench import BEAT_PERIOD, MOVING, TRAJECTORY, Bench, beat, beat_for


async def test_moving_robot_is_held_one_deadman_after_last_heartbeat(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    await beat_for(bench, 2.0)
    await bench.clock.advance(DEADMAN - BEAT_PERIOD - 0.001)
    assert bench.robot_device.holds == 0
    await bench.clock.advance(0.002)
    assert bench.robot_device.holds == 1
    (event,) = bench.link.published["dev/robot/event"]
    assert (event.code, event.danger) == ("daemon_silent", True), "the daemon learns of it, and latches"
    assert event.fields["silence"] == pytest.approx(DEADMAN, abs=0.002)


async def test_robot_that_starts_moving_while_daemon_is_silent_is_held(bench: Bench) -> None:
    await bench.clock.advance(10.0)
    bench.robot_device.stream.put_nowait(MOVING)
    await bench.clock.advance(DEADMAN / 2)
    assert bench.robot_device.holds == 1


async def test_heartbeats_that_come_late_do_not_count(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    number = await beat_for(bench, 1.0)
    await beat_for(bench, 1.0, number, delay=0.5)
    assert bench.robot_device.holds > 0, "they keep coming, and all of them are of half a second ago"


async def test_a_beat_that_is_stamped_ahead_makes_no_later_one_late(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    number = await beat_for(bench, 1.0)
    bench.link.hear(DAEMON_BEAT, Beat(number=number, session="a", alive=1e12, sent=1e12))
    await beat_for(bench, 1.0, number + 1)
    assert bench.robot_device.holds == 0
    await bench.clock.advance(1.0)
    assert bench.robot_device.holds > 0, "the one from the future is no sign of life"
    health = bench.link.published["dev/robot/state"][-1]
    assert health.dropped["implausible_beats"] == 1


@pytest.mark.parametrize(
    ("delay", "age"), [(0.9 * DEADMAN, 0.0), (0.0, 0.9 * DEADMAN), (0.45 * DEADMAN, 0.45 * DEADMAN)]
)
async def test_silence_counts_from_last_sign_of_life_however_delayed(bench: Bench, delay: float, age: float) -> None:
    """It waited in the daemon, on the way or here: the arm is not led by anyone for longer than the deadman's time."""
    bench.robot_device.stream.put_nowait(MOVING)
    number = await beat_for(bench, 1.0)
    await bench.clock.advance(0.9 * DEADMAN - BEAT_PERIOD)
    beat(bench, number, delay, age=age)  # of the same moment as the last one but for one period
    await bench.clock.advance(0.1 * DEADMAN + BEAT_PERIOD + 0.001)
    assert bench.robot_device.holds == 1
    (event,) = bench.link.published["dev/robot/event"]
    assert event.fields["silence"] == pytest.approx(DEADMAN, abs=0.002)


async def test_a_beat_that_carries_no_newer_sign_of_life_does_not_help(bench: Bench) -> None:
    """The process that sends the beats goes on while the loop hangs."""
    bench.robot_device.stream.put_nowait(MOVING)
    number = await beat_for(bench, 1.0)
    for late in range(3):
        beat(bench, number + late, age=(late + 1) * BEAT_PERIOD)
        await bench.clock.advance(BEAT_PERIOD)
    await bench.clock.advance(0.001)
    assert bench.robot_device.holds == 1


async def test_heartbeats_of_a_restarted_daemon_count_with_any_clock(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    await beat_for(bench, 1.0)
    await beat_for(bench, 1.0, first=1, delay=1000.0, session="b")
    assert bench.robot_device.holds == 1, "what the daemon before has asked for ends"
    assert bench.link.published["dev/robot/event"] == [], "and nothing is silent"


async def test_heartbeats_of_the_previous_daemon_no_longer_count(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    number = await beat_for(bench, 1.0, session="a")
    await beat_for(bench, 1.0, session="b")
    await beat_for(bench, 1.5 * DEADMAN, number, session="a")
    (event,) = bench.link.published["dev/robot/event"]
    assert event.code == "daemon_silent"


async def test_no_motion_starts_while_the_daemon_is_silent(bench: Bench) -> None:
    await bench.clock.advance(10.0)
    asking = asyncio.create_task(bench.robot.follow(TRAJECTORY))
    await settle()
    await bench.clock.advance(2 * DEADMAN)
    with pytest.raises(DeviceError, match="does not begin to move"):
        await asking
    asking = asyncio.create_task(bench.robot.follow(TRAJECTORY))
    await settle()
    beat(bench, 1)
    await bench.clock.advance(DEADMAN / 2)
    assert (await asking).outcome == "done"
    assert bench.robot_device.followed == [TRAJECTORY]


async def test_motion_waiting_for_the_daemon_does_not_start_after_stop(bench: Bench) -> None:
    """A hold of an arm that still rests is over before the heartbeat that the motion waits for has come."""
    stops: tuple[Callable[[], Awaitable[object]], ...] = (bench.robot.hold, lambda: bench.node.make_safe("stop"))
    for number, stop in enumerate(stops, start=1):
        await bench.clock.advance(10.0)
        asking = asyncio.create_task(bench.robot.follow(TRAJECTORY))
        await settle()
        await stop()
        beat(bench, number)
        await bench.clock.advance(DEADMAN / 2)
        with pytest.raises(DeviceError, match=r"older than the last hold or restart|was stopped and is latched"):
            await asking
    assert bench.robot_device.followed == []


async def test_delayed_node_reads_what_arrived_and_reports_the_delay(bench: Bench) -> None:
    """Its timer was in time: the threads that receive were not served."""
    bench.robot_device.stream.put_nowait(MOVING)
    beat(bench, 1)
    await bench.clock.advance(DEADMAN - TURN)
    bench.scheduling.waits, bench.scheduling.busy = 5 * HELD_UP, True
    await bench.clock.advance(2 * TURN)
    beat(bench, 2, 2 * TURN)
    await bench.clock.advance(2 * TURN)
    assert bench.robot_device.holds == 0
    await bench.clock.advance(DEADMAN / 2)
    assert bench.robot_device.holds == 0
    (event,) = bench.link.published["dev/robot/event"]
    assert (event.code, event.danger) == ("node_held_up", False)
    assert "9 threads want to run on 2 processors" in event.text
    beat(bench, 3)
    for number in range(4, 10):
        await bench.clock.advance(DEADMAN + TURN)  # late each time, and each time the beat has arrived already
        beat(bench, number, 2 * TURN)
        await bench.clock.advance(2 * TURN)
    assert bench.robot_device.holds == 0
    assert bench.link.published["dev/robot/event"] == [event], "it is not told each time"


async def test_delayed_node_holds_at_once_if_nothing_has_arrived(bench: Bench) -> None:
    """Whatever it waits for, the arm is held within 25 ms after the deadman's time."""
    bench.robot_device.stream.put_nowait(MOVING)
    beat(bench, 1)
    await bench.clock.advance(DEADMAN / 2)
    bench.clock.stall(2 * DEADMAN)
    await bench.clock.advance(2 * TURN)
    assert bench.robot_device.holds == 1
    codes = [event.code for event in bench.link.published["dev/robot/event"]]
    assert sorted(codes) == ["daemon_silent", "node_held_up"]
    (silent,) = (event for event in bench.link.published["dev/robot/event"] if event.code == "daemon_silent")
    assert "9 threads want to run on 2 processors" in silent.text, "the reason of the hold is the machine"


async def test_threads_that_never_rest_do_not_put_the_hold_off(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(MOVING)
    beat(bench, 1)
    bench.scheduling.waits, bench.scheduling.busy = 5 * HELD_UP, True
    await bench.clock.advance(DEADMAN + DELIVERY + TURN)
    assert bench.robot_device.holds == 1


async def test_a_resting_robot_is_left_alone_by_a_silent_daemon(bench: Bench) -> None:
    bench.robot_device.stream.put_nowait(STATE)
    await bench.clock.advance(10.0)
    assert bench.robot_device.holds == 0


FAILURES = [DeviceError("The brakes are worn."), OSError("The socket is closed.")]


@pytest.mark.parametrize("error", FAILURES)
async def test_failed_hold_does_not_end_the_watch_over_a_moving_robot(bench: Bench, error: Exception) -> None:
    bench.robot_device.error = error
    bench.robot_device.stream.put_nowait(msgspec.structs.replace(STATE, moving=True))
    for holds in (1, 2):
        await bench.clock.advance(DEADMAN + BEAT_PERIOD / 2)
        assert bench.robot_device.holds == holds


async def test_node_that_may_not_read_the_load_reports_its_hold(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.scheduling, "load", lambda: Load(None, 2))
    bench.robot_device.stream.put_nowait(MOVING)
    beat(bench, 1)
    await bench.clock.advance(DEADMAN / 2)
    bench.clock.stall(2 * DEADMAN)
    await bench.clock.advance(2 * TURN)
    events = bench.link.published["dev/robot/event"]
    assert sorted(event.code for event in events) == ["daemon_silent", "node_held_up"]
    assert all("the load of the machine is not known" in event.text for event in events)


async def test_a_report_that_fails_does_not_end_the_deadman(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def hidden() -> Load:
        raise FileNotFoundError("/proc/loadavg")

    monkeypatch.setattr(bench.scheduling, "load", hidden)
    bench.robot_device.stream.put_nowait(MOVING)
    beat(bench, 1)
    await bench.clock.advance(DEADMAN / 2)
    bench.clock.stall(2 * DEADMAN)  # both reports have the load
    await bench.clock.advance(2 * TURN)
    assert bench.robot_device.holds == 1
    assert not bench.serving.done()
    await bench.clock.advance(2 * DEADMAN)
    assert bench.robot_device.holds > 1, "it still moves, and the deadman still watches"
