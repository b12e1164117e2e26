"""The tracker corrects the command until the tool is within tolerance, or the placement is refused."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest

from pcmrs.dispatcher import Run
from pcmrs.dispatcher.execution import refusal
from pcmrs.messages import HeadMotion, JointTrajectory, LeaseState, MotionResult, Reason
from pcmrs.testing.clock import settle
from pcmrs.workflows._correction import CORRECTION_TIME
from tests.support.shipped import shipped_workflow
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench

ROUGH: dict[str, Any] = {"placement": {"tolerance_mm": 1e-3, "tolerance_deg": 1e-3, "corrections": 1}}
"""So small a tolerance that there is always something to correct."""
FINE: dict[str, Any] = {"placement": {"frames": 60, "settle_time": 0.3, "tolerance_mm": 0.08, "tolerance_deg": 0.03}}


async def test_tool_lost_by_the_tracker_in_the_correction_is_held(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    async with bench.moving("placement.confirm") as confirm:
        await bench.scene.occlude("coil", True)
        verdict = await confirm
    assert verdict.decision == "failed"
    assert verdict.reason is not None
    assert verdict.reason.code == "pose_missing"
    assert verdict.state == "held"
    await bench.scene.occlude("coil", False)
    await bench.clock.sleep(0.2)
    assert (await bench.accept("placement.back_off")).state == "standoff"


async def test_too_large_a_correction_is_not_followed(bench: WorkflowBench) -> None:
    """The head moves while the tool comes down: what the tracker asks for is no small correction any more."""
    await bench.to_standoff()
    async with bench.moving("placement.confirm") as confirm:
        await bench.scene.move_body((0.010, 0.0, 0.0))
        verdict = await confirm
    assert verdict.decision == "failed"
    assert verdict.reason is not None
    assert verdict.reason.code == "correction_too_large"
    assert verdict.reason.fields["shift_mm"] == pytest.approx(10.0, abs=0.5)
    assert verdict.state == "held"


async def test_every_round_is_in_the_result_and_the_last_in_tolerance() -> None:
    async with open_bench(FINE) as bench:
        placed = await bench.to_placed()
    assert placed.result is not None
    rounds, tolerance = placed.result["corrections"], placed.result["tolerance"]
    assert 1 <= len(rounds) <= 4
    assert all(one["shift_mm"] > 0.08 or one["turn_deg"] > 0.03 for one in rounds[:-1])
    assert rounds[-1]["shift_mm"] <= tolerance["mm"] <= 0.12
    assert rounds[-1]["turn_deg"] <= tolerance["deg"] <= 0.045
    # Measured once more, with frames of its own: what noise the decision rested on is not in it.
    assert placed.result["translation_error"] < 0.00015


async def test_a_first_error_of_millimetres_is_taken_out() -> None:
    """The standoff is measured from afar; on the way the head goes aside by 3 mm."""
    async with open_bench(FINE) as bench:
        await bench.to_standoff()
        async with bench.moving("placement.confirm") as confirm:
            await bench.scene.move_body((0.003, 0.0, 0.0))
            placed = await confirm
    assert placed.decision == "accepted", placed.reason
    assert placed.result is not None
    rounds = placed.result["corrections"]
    assert rounds[0]["shift_mm"] == pytest.approx(3.0, abs=0.5)
    assert len(rounds) >= 2
    assert placed.result["translation_error"] < 0.00015


async def test_a_head_that_keeps_moving_is_refused_with_all_rounds() -> None:
    async with open_bench(FINE) as bench:
        await bench.to_standoff()
        await bench.scene.set_motion(HeadMotion(drift=(0.0005, 0.0, 0.0)))
        verdict = await bench.do("placement.confirm")
    assert (verdict.decision, verdict.state) == ("failed", "held")
    assert verdict.reason is not None
    assert verdict.reason.code == "not_converged"
    assert "placements within" in verdict.reason.text
    rounds = verdict.reason.fields["corrections"]
    assert 2 <= len(rounds) <= 4
    assert rounds[-1]["shift_mm"] > 0.08


async def test_a_noisy_tracker_widens_the_tolerance_and_says_so() -> None:
    noisy = {"tracker": {"jitter_mm": 0.04}}
    async with open_bench(FINE, sim=noisy) as bench:
        placed = await bench.to_placed()
    assert placed.result is not None
    tolerance, last = placed.result["tolerance"], placed.result["corrections"][-1]
    assert 0.08 < tolerance["mm"] == pytest.approx(min(0.5, 2.0 * tolerance["noise_mm"]))
    assert last["shift_mm"] <= tolerance["mm"]
    assert f"placements within {tolerance['mm']:.2f} mm" in tolerance["text"]


async def test_so_many_rounds_as_configured() -> None:
    limits = {"tolerance_mm": 1e-6, "tolerance_deg": 1e-6, "noise_factor": 0.0}
    never = {"placement": {**limits, "corrections": 1, "frames": 4}}
    async with open_bench(never) as bench:
        await bench.to_standoff()
        verdict = await bench.do("placement.confirm")
    assert verdict.reason is not None
    assert verdict.reason.code == "not_converged"
    assert len(verdict.reason.fields["corrections"]) == 2


class AbsentPlanner:
    """Asks all checks in the loop, but waits with the answer to a correction until the test has done something.

    Attributes:
        corrections: Number of corrections that were to be planned.
        meanwhile: Is awaited before the answer to a correction.
        refused: Answer to a correction; None for that of the check.
    """

    def __init__(self) -> None:
        self.corrections = 0
        self.meanwhile: Callable[[], Awaitable[object]] = settle
        self.refused: Reason | None = None

    async def check(self, run: Run[Any, Any], checks: Sequence[str], within: float | None = None) -> Reason | None:
        corrects = list(checks) == ["correction_possible"]
        assert (within == CORRECTION_TIME) == corrects
        if corrects:
            self.corrections += 1
            await self.meanwhile()
        refused = refusal(shipped_workflow("ratms").registry, checks, run)
        return (self.refused if corrects else None) or refused


@asynccontextmanager
async def at_standoff(planner: AbsentPlanner) -> AsyncIterator[tuple[WorkflowBench, list[JointTrajectory]]]:
    """A bench at the standoff, and the motions that the robot is sent from now on."""
    sent: list[JointTrajectory] = []
    async with open_bench(ROUGH, planner=planner) as bench:
        await bench.to_standoff()
        follow = bench.robot.follow

        async def noting(trajectory: JointTrajectory) -> MotionResult:
            sent.append(trajectory)
            return await follow(trajectory)

        bench.robot.follow = noting  # type: ignore[method-assign]
        yield bench, sent


async def test_each_correction_is_planned_by_the_planner() -> None:
    planner = AbsentPlanner()
    async with at_standoff(planner) as (bench, sent):
        await bench.do("placement.confirm")
    assert (planner.corrections, len(sent)) == (1, 2)


@pytest.mark.parametrize("code", ["planner_late", "planner_lost"])
async def test_correction_of_a_late_or_dead_planner_is_not_sent(code: str) -> None:
    planner = AbsentPlanner()
    planner.refused = Reason(code=code, text="No answer.")
    async with at_standoff(planner) as (bench, sent):
        verdict = await bench.refuse("placement.confirm", code, "failed")
        assert (verdict.state, planner.corrections, len(sent)) == ("held", 1, 1)
        assert (await bench.accept("placement.back_off")).state == "standoff"


async def test_stop_while_a_correction_is_planned_sends_nothing() -> None:
    planner = AbsentPlanner()
    async with at_standoff(planner) as (bench, sent):
        planner.meanwhile = lambda: bench.dispatcher.stop("test:operator")
        verdict = await bench.refuse("placement.confirm", "stopped", "failed")
        await bench.clock.sleep(1.0)
        assert (verdict.state, planner.corrections, len(sent)) == ("held", 1, 1)


@pytest.mark.parametrize(
    ("change", "code"), [("latch", "latched"), ("lease", "lease_held"), ("plan", "changed_while_planning")]
)
async def test_change_while_a_correction_is_planned_sends_nothing(change: str, code: str) -> None:
    planner = AbsentPlanner()
    async with at_standoff(planner) as (bench, sent):

        async def happen() -> None:
            procedure = bench.dispatcher.procedure
            if change == "latch":
                procedure.latch()
            elif change == "lease":
                bench.dispatcher.lease.state = LeaseState(holder="another")
            else:
                procedure.data = msgspec.structs.replace(procedure.data, plan_id="another")

        planner.meanwhile = happen
        verdict = await bench.refuse("placement.confirm", code, "failed")
        assert (verdict.state, planner.corrections, len(sent)) == ("held", 1, 1)
