"""An exposed patient is not left alone: after so long without a person the session is held and latched, once."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from pcmrs.messages import DeviceEvent
from pcmrs.messages.identity import COMMANDING, HOLDING, Role
from pcmrs.service.watches.abandoned import AbandonedWatch
from pcmrs.testing.clock import settle
from tests.unit.dispatcher.dispatcher_fakes import PLACED, RETRACTED, Bench

AFTER = 60.0


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    yield made
    await made.dispatcher.close()


@pytest.fixture
async def watch(bench: Bench) -> AsyncIterator[AbandonedWatch]:
    made = AbandonedWatch(bench.dispatcher, AFTER, bench.clock)
    running = asyncio.create_task(made.run())
    await settle()
    yield made
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


def reports(bench: Bench) -> list[DeviceEvent]:
    return [each for each in bench.published if isinstance(each, DeviceEvent) and each.code == "session_abandoned"]


@pytest.mark.usefixtures("watch")
async def test_exposed_patient_left_alone_is_danger_once(bench: Bench) -> None:
    await bench.go(PLACED)
    await bench.clock.advance(AFTER - 0.1)
    assert reports(bench) == []
    await bench.clock.advance(0.2)
    (event,) = reports(bench)
    assert (event.danger, event.fields) == (True, {"after": AFTER, "stop": 1})
    assert "robot.acknowledge" in event.text, "what to do"
    assert bench.dispatcher.snapshot().latched
    await bench.clock.advance(10 * AFTER)
    assert len(reports(bench)) == 1, "it is held already"


@pytest.mark.usefixtures("watch")
async def test_only_accepted_commands_show_that_a_person_attends(bench: Bench) -> None:
    await bench.go(PLACED)
    await bench.clock.advance(AFTER - 1.0)
    assert (await bench.do("lease.acquire")).decision == "accepted"
    await bench.clock.advance(AFTER - 1.0)
    assert reports(bench) == []
    assert (await bench.do("placement.approach")).decision == "rejected"
    await bench.clock.advance(1.1)
    assert len(reports(bench)) == 1


@pytest.mark.parametrize("role", COMMANDING)
async def test_only_roles_that_may_hold_the_lease_attend(bench: Bench, watch: AbandonedWatch, role: Role) -> None:
    await bench.go(PLACED)
    await bench.clock.advance(AFTER - 1.0)
    watch.on_accepted(bench.command("toolplan.plan", user="anna", role=role))
    await bench.clock.advance(1.1)
    assert (reports(bench) == []) == (role in HOLDING)


async def test_hands_that_guide_the_tool_attend(bench: Bench, watch: AbandonedWatch) -> None:
    await bench.go(PLACED)
    for _ in range(5):
        await bench.clock.advance(0.9 * AFTER)
        watch.see()
    assert reports(bench) == []


@pytest.mark.usefixtures("watch")
async def test_patient_who_is_not_exposed_may_be_left(bench: Bench) -> None:
    await bench.go(RETRACTED)
    await bench.clock.advance(10 * AFTER)
    assert reports(bench) == []
    assert not bench.dispatcher.snapshot().latched
