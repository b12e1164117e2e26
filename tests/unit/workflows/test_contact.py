"""Pressing the tool on the body: as hard as asked, no farther than allowed, and known to all that comes after."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from pcmrs.messages import PoseMessage, Verdict
from pcmrs.workflows.data import as_transform
from tests.unit.workflows.workflow_bench import DYNAMICS, WorkflowBench, open_bench

MILLIMETRE = 1e-3


async def contact_force(bench: WorkflowBench) -> float:
    return (await bench.scene.truth()).contact_force


async def tracker_from_coil(bench: WorkflowBench) -> PoseMessage:
    return (await bench.scene.truth()).tracker_from_coil


async def pressed(bench: WorkflowBench, **force: float) -> tuple[Verdict, float]:
    """The verdict, and how far the tool truly went along its axis, m."""
    before = as_transform(await tracker_from_coil(bench))
    verdict = await bench.accept("placement.press", **force)
    shift = before.inverse() @ as_transform(await tracker_from_coil(bench)).translation
    assert np.linalg.norm(shift[:2]) < 0.1 * MILLIMETRE
    return verdict, -float(shift[2])


@pytest.mark.parametrize(("seed", "asked"), [(1, 3.0), (2, 1.0), (3, 5.0)])
async def test_the_tool_presses_as_asked(seed: int, asked: float) -> None:
    async with open_bench(sim={"seed": seed, **DYNAMICS}) as bench:
        await bench.to_placed()
        verdict, travel = await pressed(bench, force=asked)
        assert verdict.result is not None
        assert verdict.result["asked"] == asked
        assert verdict.result["force"] == pytest.approx(asked, abs=0.5)
        assert await contact_force(bench) == pytest.approx(asked, abs=0.5)
        assert verdict.result["travel"] == pytest.approx(travel, abs=0.05 * MILLIMETRE)
        assert bench.states["placement"] == "placed"


async def test_the_configured_force_counts_where_none_is_asked_for() -> None:
    async with open_bench({"contact": {"force": 4.0}}) as bench:
        await bench.to_placed()
        await pressed(bench)
        assert await contact_force(bench) == pytest.approx(4.0, abs=0.5)


async def test_pressing_again_changes_from_one_force_to_the_other() -> None:
    async with open_bench(sim=DYNAMICS) as bench:
        await bench.to_placed()
        await pressed(bench, force=4.0)
        _, travel = await pressed(bench, force=1.0)
        assert travel < 0.0, "it gives way"
        assert await contact_force(bench) == pytest.approx(1.0, abs=0.5)


async def test_later_motions_start_from_the_pressed_pose() -> None:
    async with open_bench(sim=DYNAMICS) as bench:
        await bench.to_placed()
        before = await bench.true_height()
        _, travel = await pressed(bench, force=3.0)
        assert bench.data.nudge_translation == pytest.approx((0.0, 0.0, -travel), abs=0.1 * MILLIMETRE)
        await bench.accept("placement.nudge", rotation_zyx=[0.1, 0.0, 0.0])
        assert await bench.true_height() == pytest.approx(before - travel, abs=0.3 * MILLIMETRE)
        assert (await bench.accept("placement.back_off")).state == "standoff"
        assert await contact_force(bench) == 0.0


async def test_a_tool_that_meets_nothing_is_held() -> None:
    async with open_bench() as bench:
        await bench.to_placed()
        await bench.accept("placement.nudge", translation=[0.0, 0.0, 0.015])
        verdict = await bench.refuse("placement.press", "no_contact", "failed")
        assert verdict.result is not None
        assert verdict.result["travel"] == pytest.approx(8 * MILLIMETRE, abs=0.1 * MILLIMETRE)
        assert bench.states["placement"] == "held"
        await bench.accept("placement.back_off")


async def test_a_body_that_gives_way_is_not_followed_on_and_on() -> None:
    async with open_bench(sim={"contact": {"stiffness": 100.0}, **DYNAMICS}) as bench:
        await bench.to_placed()
        verdict = await bench.refuse("placement.press", "travel_limit", "failed", force=5.0)
        assert verdict.result is not None
        assert 0.0 < verdict.result["force"] < 5.0
        assert verdict.reason is not None
        assert verdict.reason.fields["force"] == verdict.result["force"]
        assert f"the force was {verdict.result['force']:.1f} N, not 5 N" in verdict.reason.text
        assert bench.states["placement"] == "held"


@pytest.mark.parametrize("force", [0.0, 0.99, 5.01, -3.0, "3"])
async def test_a_force_that_is_not_gentle_is_refused(force: object) -> None:
    async with open_bench() as bench:
        await bench.refuse("placement.press", "bad_arguments", force=force)


async def test_a_press_goes_no_deeper_than_the_limit() -> None:
    async with open_bench(sim={"contact": {"stiffness": 100.0}, **DYNAMICS}) as bench:
        await bench.to_placed()
        await bench.accept("placement.nudge", translation=[0.0, 0.0, -0.004])
        verdict = await bench.refuse("placement.press", "travel_limit", "failed", force=5.0)
        assert verdict.result is not None
        assert verdict.result["travel"] == pytest.approx(6 * MILLIMETRE, abs=0.3 * MILLIMETRE)
        assert await bench.true_height() == pytest.approx(-10 * MILLIMETRE, abs=0.3 * MILLIMETRE)


async def test_the_whole_travel_must_be_allowed() -> None:
    async with open_bench() as bench:
        await bench.to_placed()
        await bench.accept("placement.nudge", translation=[0.0, 0.0, -0.0095])
        verdict = await bench.refuse("placement.press", "too_deep")
        assert verdict.reason is not None
        assert verdict.reason.fields["height"] == pytest.approx(-9.5 * MILLIMETRE, abs=0.5 * MILLIMETRE)
        await bench.accept("placement.nudge", translation=[0.0195, 0.0, 0.0095])
        await bench.refuse("placement.press", "nudge_too_large")


async def test_nothing_is_pressed_before_the_tool_is_placed() -> None:
    async with open_bench() as bench:
        await bench.to_standoff()
        before = await bench.true_height()
        verdict = await bench.do("placement.press")
        assert verdict.decision == "rejected"
        assert await bench.true_height() == pytest.approx(before, abs=0.1 * MILLIMETRE)


async def test_stop_ends_a_press() -> None:
    async with open_bench() as bench:
        await bench.to_placed()
        await bench.accept("placement.nudge", translation=[0.0, 0.0, 0.008])
        press = asyncio.create_task(bench.do("placement.press", force=5.0))
        await bench.until(lambda: bench.speed() > 0.005)
        await bench.dispatcher.stop("test:user")
        assert (await press).decision == "failed"
        assert bench.states["placement"] == "held"
        assert bench.dispatcher.snapshot().latched
        await bench.refuse("placement.back_off", "latched")


async def test_following_starts_from_the_pressed_pose() -> None:
    async with open_bench() as bench:
        await bench.to_placed()
        await pressed(bench, force=3.0)
        height = await bench.true_height()
        await bench.accept("placement.follow")
        await bench.clock.sleep(2.0)
        assert await bench.true_height() == pytest.approx(height, abs=0.5 * MILLIMETRE)
        await bench.accept("placement.back_off")
