"""A procedure with an arm that moves in segments: the same way, slower, and without what needs a stream."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pcmrs.kinematics.segments import COARSE, FINE, PERIOD
from pcmrs.messages import JointTrajectory, MotionResult
from tests.unit.workflows.workflow_bench import POSES, WorkflowBench, open_bench


def recorded(bench: WorkflowBench) -> list[JointTrajectory]:
    """Let the bench's arm move in segments; return the list of its motions."""
    bench.cell.point_to_point = True
    motions: list[JointTrajectory] = []
    follow = bench.cell.robot.follow

    async def record(trajectory: JointTrajectory) -> MotionResult:
        motions.append(trajectory)
        return await follow(trajectory)

    bench.cell.robot.follow = record  # type: ignore[method-assign]
    return motions


def longest(bench: WorkflowBench, motion: JointTrajectory, first: int | None = None) -> float:
    """Longest way of the tool point in one of the first segments, m."""
    cell = bench.cell
    ends = [motion.positions[0], *(motion.positions[stop] for stop in motion.stops[:first])]
    places = np.array([(cell.arm.forward(end) @ cell.flange_from_tool_tip).translation for end in ends])
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).max())


async def test_segments_are_short_between_standoff_and_target() -> None:
    async with open_bench() as bench:
        motions = recorded(bench)
        await bench.to_placed()
        approach, confirm, *corrections = motions
        assert FINE.distance * 1.01 < longest(bench, approach) <= COARSE.distance * 1.001
        for motion in (confirm, *corrections):
            assert longest(bench, motion) <= FINE.distance * 1.001
        assert len(confirm.stops) >= 70
        await bench.accept("placement.back_off")
        assert longest(bench, motions[-1]) <= FINE.distance * 1.001
        await bench.accept("placement.confirm")
        await bench.accept("placement.home")
        assert longest(bench, motions[-1], 60) <= FINE.distance * 1.001
        assert longest(bench, motions[-1]) > FINE.distance * 1.01


@pytest.mark.parametrize("operation", ["press", "follow", "guide"])
async def test_what_needs_a_stream_is_rejected_with_its_reason(operation: str) -> None:
    async with open_bench() as bench:
        recorded(bench)
        await bench.to_placed()
        verdict = await bench.refuse(f"placement.{operation}", "point_to_point")
        assert verdict.reason is not None
        assert 'kst.motion = "servo"' in verdict.reason.text


async def test_the_deadline_follows_the_planned_duration() -> None:
    """A slow arm needs longer than the blueprint allows a motion."""
    slow: dict[str, Any] = {"motion": {"near_velocity": 0.006}}
    async with open_bench(slow) as bench:
        motions = recorded(bench)
        await bench.to_standoff()
        limit = bench.dispatcher.procedure.blueprint.branches["placement"].operations["approach"].timeout_s
        assert PERIOD * len(motions[0].positions) > limit


async def test_stop_lets_no_segment_follow() -> None:
    async with open_bench() as bench:
        motions = recorded(bench)
        await bench.register()
        async with bench.moving("placement.approach") as approach:
            bench.dispatcher.press_stop("test")
            verdict = await approach
        assert verdict.decision != "accepted"
        assert bench.states["placement"] == "held"
        here = (await bench.robot.joints()).positions
        assert np.abs(np.array(here) - motions[0].positions[-1]).max() > 0.01


async def test_the_deadline_counts_both_legs_of_an_approach() -> None:
    """From target to target, the arm goes to the last standoff first."""
    slow: dict[str, Any] = {"motion": {"near_velocity": 0.005}}
    async with open_bench(slow) as bench:
        motions = recorded(bench)
        await bench.to_placed()
        before = len(motions)
        await bench.accept("toolplan.plan", **POSES[1])
        await bench.accept("placement.approach")
        limit = bench.dispatcher.procedure.blueprint.branches["placement"].operations["approach"].timeout_s
        assert sum(PERIOD * len(motion.positions) for motion in motions[before:]) > limit
