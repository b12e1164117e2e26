"""Checks that a planner asks: the loop goes on, and what has changed meanwhile counts."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import msgspec
import pytest

from pcmrs.dispatcher import Run
from pcmrs.dispatcher.execution import MOST_PLANS
from pcmrs.messages import Reason, Verdict
from pcmrs.testing.clock import settle
from tests.unit.dispatcher.dispatcher_fakes import HELD, RETRACTED, STANDOFF, Bench, Notes


class GatedPlanner:
    """Answers when the test opens its gate.

    Attributes:
        asked: States by which checks were asked, in order.
        meanwhile: Is done while a check is asked.
        refused: The answer.
    """

    def __init__(self) -> None:
        self.gate = asyncio.Event()
        self.gate.set()
        self.asked: list[dict[str, str]] = []
        self.meanwhile: Callable[[], None] = lambda: None
        self.refused: Reason | None = None

    async def check(self, run: Run[Any, Notes]) -> Reason | None:
        self.asked.append(dict(run.states))
        await self.gate.wait()
        self.meanwhile()
        return self.refused


@pytest.fixture
def planner() -> GatedPlanner:
    return GatedPlanner()


@pytest.fixture
async def bench(planner: GatedPlanner) -> AsyncIterator[Bench]:
    made = Bench(planner=planner, lasting=("approach_possible", "plan_reachable"))
    yield made
    planner.gate.set()
    await made.dispatcher.close()


def told(verdict: Verdict) -> tuple[str, str]:
    assert verdict.reason is not None
    return verdict.decision, verdict.reason.code


async def test_loop_continues_while_a_motion_is_planned(bench: Bench, planner: GatedPlanner) -> None:
    await bench.go(RETRACTED)
    planner.gate.clear()
    approach = await bench.begin("placement.approach")
    assert told(await bench.do("placement.home")) == ("rejected", "busy")
    assert bench.dispatcher.snapshot().running == []  # nothing has begun
    planner.gate.set()
    assert (await approach).decision == "accepted"
    assert bench.joint == STANDOFF


async def test_a_refusal_of_the_planner_rejects_and_nothing_begins(bench: Bench, planner: GatedPlanner) -> None:
    await bench.go(RETRACTED)
    bench.script.entered.clear()
    planner.refused = Reason(code="planner_lost", text="It has ended.")
    assert told(await bench.do("placement.approach")) == ("rejected", "planner_lost")
    assert (bench.script.entered, bench.joint) == ([], RETRACTED)


async def test_stop_ends_the_planning_and_does_not_wait_for_it(bench: Bench, planner: GatedPlanner) -> None:
    await bench.go(RETRACTED)
    bench.script.entered.clear()
    planner.gate.clear()
    approach = await bench.begin("placement.approach")
    await bench.dispatcher.stop("test:operator")
    assert told(await approach) == ("rejected", "stopped")
    await bench.do("robot.acknowledge", source="local:test")
    planner.gate.set()
    await settle()
    assert "placement.approach" not in bench.script.entered


async def test_motion_latched_while_it_is_planned_does_not_start(bench: Bench, planner: GatedPlanner) -> None:
    """The latch is asked again, whoever has set it."""
    await bench.go(RETRACTED)
    bench.script.entered.clear()
    planner.meanwhile = bench.dispatcher.procedure.latch
    assert told(await bench.do("placement.approach")) == ("rejected", "latched")
    assert bench.script.entered == []


async def test_a_motion_is_planned_again_where_the_plan_has_changed(bench: Bench, planner: GatedPlanner) -> None:
    await bench.go(RETRACTED)
    planner.asked.clear()
    procedure = bench.dispatcher.procedure

    def change_once() -> None:
        if len(planner.asked) == 1:
            procedure.data = msgspec.structs.replace(procedure.data, plan_id="another")

    planner.meanwhile = change_once
    assert (await bench.do("placement.approach")).decision == "accepted"
    assert len(planner.asked) == 2


async def test_a_motion_whose_plan_never_stands_still_is_rejected(bench: Bench, planner: GatedPlanner) -> None:
    await bench.go(RETRACTED)
    planner.asked.clear()
    procedure = bench.dispatcher.procedure

    def change() -> None:
        procedure.data = msgspec.structs.replace(procedure.data, plan_id=f"plan {len(planner.asked)}")

    planner.meanwhile = change
    assert told(await bench.do("placement.approach")) == ("rejected", "changed_while_planning")
    assert len(planner.asked) == MOST_PLANS


async def test_a_planner_that_raises_rejects_and_the_daemon_works_on(bench: Bench, planner: GatedPlanner) -> None:
    await bench.go(RETRACTED)

    def fail() -> None:
        raise OSError("broken pipe")

    planner.meanwhile = fail
    assert told(await bench.do("placement.approach")) == ("rejected", "check_raised")
    planner.meanwhile = lambda: None
    assert (await bench.do("placement.approach")).decision == "accepted"


async def test_a_plan_is_put_in_force_when_it_has_been_checked(bench: Bench, planner: GatedPlanner) -> None:
    planner.gate.clear()
    plan = await bench.begin("toolplan.plan", arguments={"values": [1.0]})
    assert bench.joint[2] == "0"
    planner.gate.set()
    assert (await plan).decision == "accepted"
    assert bench.joint[2] == "1"
    assert bench.recorder.with_intent[(await plan).id]  # one row for both: it touches nothing outside


async def test_dry_run_asks_the_planner(bench: Bench, planner: GatedPlanner) -> None:
    await bench.go(RETRACTED)
    planner.refused = Reason(code="unreachable", text="Too far.")
    before = len(bench.recorder.rows)
    dry_run = await bench.dispatcher.dry_run(bench.command("placement.approach"))
    assert dry_run.reason == planner.refused
    assert (len(bench.recorder.rows), bench.joint) == (before, RETRACTED)
    planner.refused = None
    planner.meanwhile = bench.dispatcher.procedure.latch
    dry_run = await bench.dispatcher.dry_run(bench.command("placement.approach"))
    assert dry_run.reason is not None
    assert dry_run.reason.code == "latched"


@pytest.mark.parametrize("refuses", [True, False])
async def test_step_that_replans_its_motion_fails_if_that_is_refused(
    bench: Bench, planner: GatedPlanner, refuses: bool
) -> None:
    moved: list[str] = []

    async def plan_again_and_move(run: Run[Any, Notes]) -> None:
        if refuses:
            planner.refused = Reason(code="unreachable", text="Too far by now.", fields={"distance": 0.9})
        await run.replan()
        moved.append(run.command.operation)

    await bench.go(RETRACTED)
    planner.asked.clear()
    bench.script.steps["placement.approach"] = plan_again_and_move
    verdict = await bench.do("placement.approach")
    assert len(planner.asked) > 1, "again by the step"
    if refuses:
        assert told(verdict) == ("failed", "unreachable")
        assert verdict.reason is not None
        assert (verdict.reason.text, verdict.reason.fields["distance"]) == ("Too far by now.", 0.9)
        assert (moved, bench.joint) == ([], HELD)
    else:
        assert (verdict.decision, set(moved), bench.joint) == ("accepted", {"approach"}, STANDOFF)


async def test_a_stop_during_a_planned_motion_is_as_ever(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.script.hang("placement.approach")
    approach = await bench.begin("placement.approach")
    await bench.dispatcher.stop("test:operator")
    assert told(await approach) == ("failed", "stopped")
    assert bench.joint == HELD
