"""Presses of Stop that meet a Stop under way: one Stop, one row with their number, and nothing is lost by it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any, cast

import pytest

from pcmrs.dispatcher.events import PRESSED_AGAIN
from pcmrs.dispatcher.stops import SOURCES
from pcmrs.messages import DeviceEvent, Verdict
from pcmrs.service.gateway_adapter import GatewayAdapter
from pcmrs.testing.clock import settle
from pcmrs.workflows.cell import Cell
from tests.unit.dispatcher.dispatcher_fakes import HELD, Bench

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


def code(verdict: Verdict) -> str:
    return "" if verdict.reason is None else verdict.reason.code


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
