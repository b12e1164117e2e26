"""Numbers of Stops, acknowledgements, presses that join a pending Stop, and holds."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Any, cast

import pytest

from pcmrs.background import BackgroundTasks
from pcmrs.clock import SystemClock
from pcmrs.dispatcher.events import PRESSED_AGAIN
from pcmrs.dispatcher.stops import SOURCES, STANDSTILL, YOUNG, Hold, Stops
from pcmrs.messages import DeviceEvent
from pcmrs.service.gateway_adapter import GatewayAdapter
from pcmrs.testing.clock import settle
from pcmrs.workflows.cell import Cell
from tests.unit.dispatcher.dispatcher_fakes import HELD, STANDOFF, Bench, code


async def _wait_for(hold: asyncio.Task[bool]) -> bool:
    return await asyncio.shield(hold)


async def test_hold_continues_when_its_caller_is_cancelled() -> None:
    tasks, stands, held = BackgroundTasks(print), asyncio.Event(), asyncio.Event()

    async def hold(_latch: bool) -> None:
        await stands.wait()
        held.set()

    asked = asyncio.create_task(Hold(hold, tasks).end_motion())
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    asked.cancel()
    with suppress(asyncio.CancelledError):
        await asked
    stands.set()
    await tasks.wait()

    assert held.is_set()


PRESSES = 5_000


@pytest.fixture
async def held() -> AsyncIterator[tuple[Bench, GatewayAdapter, asyncio.Event]]:
    """A bench whose holds are answered when the event is set, and the gateway's way to its Stop."""
    bench = Bench()
    await bench.go(HELD)
    answered = asyncio.Event()
    bench.hold = answered.wait
    core = GatewayAdapter(cast(Any, bench.dispatcher), cast(Cell, None), bench.dispatcher.submit)
    yield bench, core, answered
    answered.set()
    await bench.dispatcher.close()


def events(bench: Bench) -> list[DeviceEvent]:
    return [message for message in bench.published if isinstance(message, DeviceEvent)]


async def test_thousands_of_presses_are_one_stop_and_one_counted_row(
    held: tuple[Bench, GatewayAdapter, asyncio.Event],
) -> None:
    bench, core, answered = held
    before, rows = bench.dispatcher.stop_number, len(bench.recorder.rows)
    stops = [asyncio.create_task(core.stop("bus:eve")) for _ in range(PRESSES)]
    await settle()
    answered.set()
    assert await asyncio.gather(*stops) == [True] * PRESSES
    await settle()
    assert bench.dispatcher.stop_number == before + 1
    assert [name for _, name, _, _ in bench.recorder.rows[rows:]] == ["stopped", PRESSED_AGAIN]
    counted = events(bench)[-1]
    assert (counted.code, counted.danger) == (PRESSED_AGAIN, False)
    assert counted.fields == {"stop": before + 1, "presses": PRESSES - 1, "by": {"bus:eve": PRESSES - 1}}


async def test_next_press_after_standstill_is_a_separate_stop(
    held: tuple[Bench, GatewayAdapter, asyncio.Event],
) -> None:
    bench, core, answered = held
    answered.set()
    before = bench.dispatcher.stop_number
    for _ in range(3):
        assert await core.stop("bus:eve")
    assert bench.dispatcher.stop_number == before + 3


async def test_press_ends_commands_started_since_the_stop(held: tuple[Bench, GatewayAdapter, asyncio.Event]) -> None:
    bench, core, answered = held
    first = asyncio.create_task(core.stop("bus:eve"))
    await settle()
    bench.script.hang("digitization.digitize_all")
    planning = await bench.begin("digitization.digitize_all")
    before = bench.dispatcher.stop_number
    second = asyncio.create_task(core.stop("bus:eve"))
    await settle()
    assert bench.dispatcher.stop_number == before + 1
    answered.set()
    assert code(await planning) == "stopped"
    await asyncio.gather(first, second)


async def test_sources_have_separate_stops_up_to_a_limit(
    held: tuple[Bench, GatewayAdapter, asyncio.Event],
) -> None:
    bench, core, answered = held
    before = bench.dispatcher.stop_number
    stops = [asyncio.create_task(core.stop(f"bus:eve{number}")) for number in range(2 * SOURCES)]
    await settle()
    assert bench.dispatcher.stop_number == before + SOURCES
    stops.append(asyncio.create_task(core.stop("udp:planner:127.0.0.1:4000")))
    await settle()
    assert bench.dispatcher.stop_number == before + SOURCES + 1, "those of the bus take no places of others"
    answered.set()
    await asyncio.gather(*stops)
    await settle()
    joined = {f"bus:eve{number}": 1 for number in range(SOURCES, 2 * SOURCES)}
    assert any(each.fields.get("by") == joined for each in events(bench))


async def test_nothing_releases_the_latch_while_presses_are_counted(
    held: tuple[Bench, GatewayAdapter, asyncio.Event],
) -> None:
    bench, core, answered = held
    stops = [asyncio.create_task(core.stop("bus:eve")) for _ in range(2)]
    await settle()
    assert code(await bench.do("robot.acknowledge")) == "stop_pending"
    answered.set()
    await asyncio.gather(*stops)
    assert (await bench.do("robot.acknowledge")).decision == "accepted"


async def test_cancelled_caller_does_not_end_the_hold_of_others() -> None:
    stands = asyncio.Event()

    async def standing(_latch: bool) -> None:
        await stands.wait()

    hold = Hold(standing, BackgroundTasks(print))
    impatient, patient = (asyncio.create_task(_wait_for(hold.stop())) for _ in range(2))
    await settle()
    impatient.cancel()
    await settle()
    stands.set()
    assert await patient


async def test_stops_share_a_hold_that_is_under_way(bench: Bench) -> None:
    await asyncio.gather(*(bench.dispatcher.stop("test:operator") for _ in range(50)))
    assert bench.holds == 1
    assert [row[:2] for row in bench.recorder.rows] == [("event", "stopped")] * 50


async def test_nobody_acknowledges_while_the_hold_is_under_way(bench: Bench) -> None:
    await bench.go(HELD)
    answered = asyncio.Event()
    bench.hold = answered.wait
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    assert bench.dispatcher.snapshot().stop.pending == ["standstill"]
    refused = await bench.do("robot.acknowledge")
    assert code(refused) == "stop_pending"
    assert refused.reason is not None
    assert "standstill" in refused.reason.text
    answered.set()
    assert await stop
    assert (bench.dispatcher.snapshot().stop.pending, bench.dispatcher.snapshot().stop.confirmed) == ([], True)
    assert (await bench.do("robot.acknowledge")).decision == "accepted"


async def test_the_hold_of_a_motion_is_merged_with_no_other(bench: Bench) -> None:
    """Its request may still be on its way when the hold of the Stop is answered: only a later hold outdates it."""
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    motion = await bench.begin("placement.confirm")
    answered = asyncio.Event()
    bench.hold = answered.wait
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    assert bench.latching == [True, False]
    answered.set()
    assert await stop
    assert (await motion).state == "held"


async def test_a_stop_has_its_number_before_anything_is_awaited(bench: Bench) -> None:
    await bench.go(HELD)
    before = bench.dispatcher.stop_number
    stops = [bench.dispatcher.begin_stop("test:operator") for _ in range(3)]
    state = bench.dispatcher.snapshot().stop
    assert (state.number, state.confirmed) == (before + 3, False)
    await asyncio.gather(*stops)
    rows = [message.fields["stop"] for message in bench.published if isinstance(message, DeviceEvent)]
    assert rows == [before + 1, before + 2, before + 3]


async def test_stops_of_a_later_run_have_greater_numbers(bench: Bench) -> None:
    bench.dispatcher.take_up(latched=True, unknown=[], start=7)
    assert bench.dispatcher.stop_number > 7
    other = Bench()
    other.dispatcher.take_up(latched=False, unknown=[], start=8)
    for _ in range(100):
        await bench.dispatcher.stop("test:operator")
    await other.dispatcher.stop("test:operator")
    assert other.dispatcher.stop_number > bench.dispatcher.stop_number
    await other.dispatcher.close()


async def test_acknowledgement_of_an_older_stop_releases_nothing(bench: Bench) -> None:
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    older = bench.dispatcher.stop_number
    await bench.dispatcher.stop("test:operator")
    refused = await bench.do("robot.acknowledge", arguments={"stop": older})
    assert code(refused) == "stop_outdated"
    assert refused.reason is not None
    assert refused.reason.fields == {"stop": older, "newest": older + 1}
    assert bench.dispatcher.snapshot().latched


@pytest.mark.parametrize("name", ["7", 1.5, True, [1]])
async def test_an_acknowledgement_that_names_no_number_is_malformed(bench: Bench, name: Any) -> None:
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    assert code(await bench.do("robot.acknowledge", arguments={"stop": name})) == "bad_arguments"
    assert bench.dispatcher.snapshot().latched


async def test_unnamed_stop_is_acknowledged_only_on_site_and_not_young(bench: Bench) -> None:
    """Only a user on site acknowledges without naming the Stop, and only one that is not young."""
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    assert code(await bench.do("robot.acknowledge", arguments={}, user="local")) == "stop_not_named"
    await bench.clock.advance(YOUNG + 0.01)
    assert code(await bench.do("robot.acknowledge", arguments={}, user="carla")) == "stop_not_named"
    assert bench.dispatcher.snapshot().latched
    assert (await bench.do("robot.acknowledge", arguments={}, user="local")).decision == "accepted"
    assert not bench.dispatcher.snapshot().latched


async def test_stops_that_wait_for_one_hold_end_with_it() -> None:
    """The second of two quick Stops raised in the loop when the hold ended; found by exploring."""
    loop, errors = asyncio.get_running_loop(), list[dict[str, Any]]()
    loop.set_exception_handler(lambda _, context: errors.append(context))
    stops, hold = Stops(SystemClock()), loop.create_future()
    for _ in range(2):
        stops.begin()
        stops.wait_for(STANDSTILL, hold)
    hold.set_result(True)
    await asyncio.sleep(0)
    assert (errors, stops.state.pending) == ([], [])
