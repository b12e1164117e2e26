"""Motions of the tool: what they require, where they end, and what is refused before anything moves."""

from __future__ import annotations

import asyncio
from math import radians
from typing import Any

import numpy as np
import pytest

from tests.unit.workflows.workflow_bench import DYNAMICS, POSES, WorkflowBench, open_bench


async def test_a_new_plan_at_the_standoff_needs_a_new_approach(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.accept("toolplan.plan", **POSES[1])
    assert bench.states["placement"] == "replanned"
    assert not bench.dispatcher.snapshot().running
    assert bench.speed() < 1e-3
    for name in ("confirm", "nudge", "follow", "guide"):
        assert (await bench.do(f"placement.{name}")).decision == "rejected"
    assert (await bench.accept("placement.back_off")).state == "retracted"
    assert (await bench.do("placement.confirm")).decision == "rejected"
    await bench.accept("placement.home")
    assert (await bench.accept("placement.approach")).state == "standoff"
    await bench.accept("placement.confirm")


async def test_poses_on_all_sides_of_the_head_are_placed_from_home(bench: WorkflowBench) -> None:
    await bench.register()
    for pose in POSES[::4]:
        await bench.accept("toolplan.plan", **pose)
        await bench.accept("placement.approach")
        placed = await bench.accept("placement.confirm")
        assert placed.result is not None
        assert placed.result["translation_error"] < 0.0005
        assert (await bench.accept("placement.back_off")).state == "standoff"
        await bench.accept("placement.home")


@pytest.mark.parametrize("name", ["home", "to_initial"])
async def test_tool_may_go_home_from_the_target_and_backs_off_first(bench: WorkflowBench, name: str) -> None:
    await bench.to_placed()
    assert (await bench.accept(f"placement.{name}")).state == "retracted"
    assert bench.cell.joints is not None
    assert bench.cell.joints.positions == pytest.approx(bench.cell.home, abs=2e-3)


async def test_to_initial_returns_to_the_remembered_joints(bench: WorkflowBench) -> None:
    await bench.connect()
    initial = [0.3, -0.5, 0.0, -1.6, 0.0, 1.2, -1.0]
    bench.cell.initial_joints = initial
    await bench.accept("placement.to_initial", confirm=True)
    assert bench.cell.joints is not None
    assert bench.cell.joints.positions == pytest.approx(initial, abs=2e-3)


@pytest.mark.parametrize("state", ["standoff", "placed"])
async def test_nudges_move_the_tool_in_its_own_frame_and_add_up(bench: WorkflowBench, state: str) -> None:
    await (bench.to_standoff() if state == "standoff" else bench.to_placed())
    height = await bench.true_height()
    for number in (1, 2, 3):
        verdict = await bench.accept("placement.nudge", translation=[0.0, 0.0, 0.004])
        assert verdict.state == state
        assert await bench.true_height() == pytest.approx(height + 0.004 * number, abs=0.0005)
    await bench.accept("placement.nudge", rotation_zyx=[radians(5.0), 0.0, 0.0])
    assert bench.data.nudge_translation == pytest.approx((0.0, 0.0, 0.012))
    assert bench.data.nudge_rotation_zyx == pytest.approx((radians(5.0), 0.0, 0.0))


async def test_nudges_are_limited_in_sum_and_reset_by_an_approach(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.refuse("placement.nudge", "nudge_too_large", translation=[0.0, 0.0, 0.021])
    await bench.accept("placement.nudge", translation=[0.0, 0.0, 0.015])
    await bench.refuse("placement.nudge", "nudge_too_large", translation=[0.0, 0.0, 0.006])
    await bench.refuse("placement.nudge", "nudge_too_large", rotation_zyx=[0.0, radians(11.0), 0.0])
    await bench.accept("placement.home")
    await bench.accept("placement.approach")
    await bench.accept("placement.nudge", translation=[0.0, 0.0, 0.006])


async def test_the_body_must_be_seen_for_a_motion_towards_it(bench: WorkflowBench) -> None:
    await bench.register()
    await bench.scene.occlude("body_ref", True)
    await bench.clock.sleep(1.0)
    await bench.refuse("placement.approach", "pose_stale")
    await bench.scene.occlude("body_ref", False)
    await bench.clock.sleep(0.2)
    await bench.accept("placement.approach")
    await bench.scene.occlude("coil", True)
    await bench.clock.sleep(1.0)
    await bench.refuse("placement.confirm", "pose_stale")
    await bench.refuse("placement.nudge", "pose_stale", translation=[0.0, 0.0, 0.001])
    assert (await bench.accept("placement.home")).state == "retracted"


async def test_the_robot_is_not_disconnected_near_the_patient(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    for name in ("robot.disconnect", "registration.reinit", "toolplan.reinit", "placement.reinit"):
        await bench.refuse(name, "tool_near_patient")
    await bench.accept("placement.home")
    await bench.accept("robot.disconnect")


async def test_the_speed_limits_are_kept() -> None:
    limits = {"linear_velocity": 0.1, "joint_speed_fraction": 0.1}
    async with open_bench({"motion": limits}, DYNAMICS) as bench:
        await bench.register()
        fastest = np.zeros(7)
        async with bench.moving("placement.approach") as approach:
            while not approach.done():
                assert bench.cell.joints is not None
                fastest = np.maximum(fastest, np.abs(bench.cell.joints.velocities))
                await bench.clock.sleep(0.02)
        assert (fastest <= 0.1 * bench.cell.arm.velocity * 1.05).all()
        assert fastest.max() > 0.02


async def test_a_retreat_waits_for_nothing_on_other_branches(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.accept("toolplan.clear")
    digitizing = asyncio.create_task(bench.do("digitization.digitize_all"))
    await bench.until(lambda: bool(bench.dispatcher.snapshot().running))
    assert (await bench.accept("placement.back_off")).state == "retracted"
    assert (await digitizing).decision == "accepted"


async def test_tool_continues_only_to_the_plan_it_was_brought_to(unrevoked: WorkflowBench) -> None:
    """A blueprint that forgets to take the tool from its place: the checks do not trust its states."""
    await unrevoked.to_standoff()
    await unrevoked.accept("toolplan.plan", **POSES[1])
    assert unrevoked.states["placement"] == "standoff"
    motions: dict[str, dict[str, Any]] = {"confirm": {}, "nudge": {"translation": [0.0, 0.0, 0.001]}, "guide": {}}
    for name, arguments in motions.items():
        verdict = await unrevoked.refuse(f"placement.{name}", "not_at_plan", **arguments)
        assert verdict.reason is not None
        assert "approach again" in verdict.reason.text
    await unrevoked.accept("placement.home")
    await unrevoked.accept("placement.approach")
    await unrevoked.accept("placement.confirm")
