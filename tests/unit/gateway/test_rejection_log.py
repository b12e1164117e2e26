"""Refusals by the gateway are reported: the first of a reason at once, more at a bounded rate, each counted once."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from pcmrs.background import BackgroundTasks
from pcmrs.gateway.rejection_log import PERIOD, RejectionLog
from pcmrs.testing.clock import ManualClock, settle
from tests.unit.gateway.gateway_fakes import FakeCore

SOURCE = "udp:planner:127.0.0.1:4000"


class Bench:
    def __init__(self) -> None:
        self.core, self.clock, self.tasks = FakeCore(), ManualClock(), BackgroundTasks()
        self.refusals = RejectionLog(self.core, self.clock, self.tasks)

    async def refuse(self, times: int, reason: str = "malformed") -> None:
        for number in range(times):
            self.refusals.add(SOURCE, reason, f"number {number}")
        await settle()

    @property
    def told(self) -> list[tuple[str, int, str]]:
        return [(event.fields["reason"], event.fields["count"], event.text) for event in self.core.events]


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    yield made
    await made.tasks.close()


async def test_first_refusal_is_reported_with_source_and_reason(bench: Bench) -> None:
    await bench.refuse(1)
    (event,) = bench.core.events
    assert (event.device, event.code, event.danger) == ("gateway", "refused", False)
    assert event.fields == {"count": 1, "source": SOURCE, "reason": "malformed"}


async def test_flood_has_one_report_each_period_and_counts_everything(bench: Bench) -> None:
    for _ in range(3):
        await bench.refuse(1000)
        await bench.clock.advance(PERIOD)
    counts = [count for _, count, _ in bench.told]
    assert counts == [1, 999, 1000, 1000]


async def test_new_reason_during_a_flood_is_reported_at_once(bench: Bench) -> None:
    await bench.refuse(1000)
    await bench.refuse(1, "no_rotation")
    assert bench.told == [("malformed", 1, "number 0"), ("no_rotation", 1, "number 0")]


async def test_refusal_after_a_quiet_period_is_reported_at_once(bench: Bench) -> None:
    await bench.refuse(1)
    await bench.clock.advance(PERIOD)
    await bench.refuse(1)
    assert bench.told == [("malformed", 1, "number 0"), ("malformed", 1, "number 0")]
