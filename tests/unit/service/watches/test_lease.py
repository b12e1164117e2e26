"""A holder who does not renew the lease loses it, and a robot that moves is held."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from pcmrs.dispatcher.lease import LAPSED
from pcmrs.messages import DeviceEvent
from pcmrs.service.watches.lease import LOOKS, LeaseWatch
from pcmrs.testing.clock import settle
from tests.unit.dispatcher.dispatcher_fakes import Bench

LIMIT = 10.0


@asynccontextmanager
async def watched(*, moving: bool = False) -> AsyncIterator[Bench]:
    """A dispatcher whose lease anna has taken."""
    bench = Bench()
    watch = asyncio.create_task(LeaseWatch(bench.dispatcher, lambda: moving, bench.clock, LIMIT).run())
    try:
        await settle()
        await ask(bench, "acquire")
        yield bench
    finally:
        watch.cancel()
        await asyncio.gather(watch, return_exceptions=True)
        await bench.dispatcher.close()


async def ask(bench: Bench, operation: str) -> None:
    assert (await bench.do(f"lease.{operation}", source="bus:anna", user="anna")).decision == "accepted"


def lapses(bench: Bench) -> list[DeviceEvent]:
    return [each for each in bench.published if isinstance(each, DeviceEvent) and each.code == LAPSED]


@pytest.mark.parametrize("moving", [True, False])
async def test_silent_holder_loses_the_cell_and_motion_is_held(moving: bool) -> None:
    async with watched(moving=moving) as bench:
        await bench.clock.advance(LIMIT)
        assert bench.dispatcher.lease.holder == "anna", "the limit has not passed"
        await bench.clock.advance(LIMIT / LOOKS)
        assert bench.dispatcher.lease.holder is None
        (event,) = lapses(bench)
        assert (event.danger, event.fields["holder"]) == (moving, "anna")
        assert (bench.dispatcher.snapshot().latched, bench.holds) == (moving, int(moving))
        await bench.clock.advance(5 * LIMIT)
        assert len(lapses(bench)) == 1, "nobody holds it any more"


async def test_holder_who_renews_keeps_the_cell() -> None:
    async with watched() as bench:
        for _ in range(10):
            await bench.clock.advance(0.9 * LIMIT)
            await ask(bench, "renew")
        assert bench.dispatcher.lease.holder == "anna"
        assert lapses(bench) == []
