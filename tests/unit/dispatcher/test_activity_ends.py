"""Ends of activities: what one that has ended, or never began, must not do."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from pcmrs.errors import RefusalError, UnknownOutcomeError
from pcmrs.testing.clock import settle
from tests.support.altered import with_operation
from tests.unit.dispatcher.dispatcher_fakes import Bench
from tests.unit.dispatcher.following import FOLLOWING


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench(FOLLOWING, ["placement"])
    yield made
    await made.dispatcher.close()


async def go(bench: Bench, *operations: str) -> None:
    for operation in operations:
        assert (await bench.do(f"placement.{operation}")).decision == "accepted"
    await settle()


def asked_by_activities(bench: Bench) -> list[str]:
    return [each.operation for each in bench.recorder.commands if each.source.startswith("activity:")]


@pytest.mark.parametrize("way", [("stand", "withdraw"), ("let_go",), ("withdraw",)])
async def test_activity_that_was_asked_to_end_sends_no_command(bench: Bench, way: tuple[str, ...]) -> None:
    await go(bench, "approach", "follow", *way)
    assert asked_by_activities(bench) == []


async def test_nothing_is_asked_for_when_the_daemon_ends(bench: Bench) -> None:
    await go(bench, "approach", "follow")
    await bench.dispatcher.close()
    assert asked_by_activities(bench) == []


async def enter_in_a_fail_stop(bench: Bench, name: str) -> None:
    """Fail while the decision that enters the state of an activity is under way; it is committed nevertheless."""
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    entering = await bench.begin(name)
    bench.recorder.failing.add("recall")
    await bench.do("plan.change")
    assert bench.dispatcher.broken is not None
    bench.recorder.failing.clear()
    gate.set()
    assert (await entering).decision == "accepted"
    await settle()


async def test_none_begins_after_a_fail_stop(bench: Bench) -> None:
    await go(bench, "approach")
    await enter_in_a_fail_stop(bench, "placement.follow")
    assert bench.script.acting == []


async def test_motionless_activity_does_not_start_after_a_fail_stop(bench: Bench) -> None:
    await go(bench, "approach", "follow")
    await enter_in_a_fail_stop(bench, "placement.stand")
    assert [act.name for act in bench.script.acting] == ["follow_head"]


async def test_state_that_outlives_its_activity_is_fail_stop() -> None:
    """It is a fail-stop if the operation that follows the end does not lead out of the state."""
    bench = Bench(with_operation(FOLLOWING, "placement", "following_lost", checks=("leaving_possible",)), ["placement"])
    ended = asyncio.Event()

    async def end(_act: object) -> None:
        await ended.wait()

    bench.script.activities["follow_head"] = end
    bench.script.checks["placement.following_lost"] = RefusalError("stuck", "The test wants this to be refused.")
    await go(bench, "approach", "follow")
    ended.set()
    await settle()
    assert bench.dispatcher.broken is not None
    assert "following_lost has not led out of it" in bench.dispatcher.broken.text
    await bench.dispatcher.close()


async def test_unconfirmed_hold_after_stop_is_reported_once(bench: Bench) -> None:
    async def hold() -> None:
        bench.holds += 1
        if bench.holds > 1:
            raise UnknownOutcomeError("The robot is silent.")

    bench.hold = hold
    await go(bench, "approach", "follow")
    assert not await bench.dispatcher.stop("test:operator")
    await settle()
    events = [name for kind, name, _, _ in bench.recorder.rows if kind == "event"]
    assert [events.count(name) for name in ("stopped", "hold_not_confirmed")] == [1, 1]


async def test_activity_prevented_by_the_latch_is_not_reported_started(bench: Bench) -> None:
    await go(bench, "approach")
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    following = await bench.begin("placement.follow")
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    gate.set()
    await asyncio.gather(following, stop)
    await settle()
    assert "activity_started" not in [name for _, name, _, _ in bench.recorder.rows]
