"""The tracker corrects the command until the tool is within tolerance, or the placement is refused."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.messages import HeadMotion
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench

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
    rounds = placed.result["corrections"]
    assert 1 <= len(rounds) <= 4
    assert all(one["shift_mm"] > 0.08 or one["turn_deg"] > 0.03 for one in rounds[:-1])
    assert rounds[-1]["shift_mm"] <= 0.08
    assert rounds[-1]["turn_deg"] <= 0.03
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
    assert "0.08 mm" in verdict.reason.text
    rounds = verdict.reason.fields["corrections"]
    assert 2 <= len(rounds) <= 4
    assert rounds[-1]["shift_mm"] > 0.08


async def test_so_many_rounds_as_configured() -> None:
    never = {"placement": {"tolerance_mm": 1e-6, "tolerance_deg": 1e-6, "corrections": 1, "frames": 4}}
    async with open_bench(never) as bench:
        await bench.to_standoff()
        verdict = await bench.do("placement.confirm")
    assert verdict.reason is not None
    assert verdict.reason.code == "not_converged"
    assert len(verdict.reason.fields["corrections"]) == 2
