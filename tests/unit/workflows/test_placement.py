"""Motions of the tool: what they require, where they end, and what is refused before anything moves."""

from __future__ import annotations

import asyncio
from math import radians
from typing import Any

import numpy as np
import pytest

from pcmrs.spatial import distance
from pcmrs.workflows.paths import distance_from_body
from tests.unit.workflows.workflow_bench import DYNAMICS, LANDMARKS, POSES, WorkflowBench, open_bench

TURNED_OVER = [0.0, 1.0, 0.0, 0.0]


async def test_a_new_plan_at_the_standoff_needs_a_new_approach(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.accept("toolplan.plan", **POSES[1])
    assert bench.states["placement"] == "held"
    assert not bench.dispatcher.snapshot().running
    assert bench.speed() < 1e-3
    assert (await bench.do("placement.confirm")).decision == "rejected"
    assert (await bench.do("placement.home")).decision == "rejected"
    assert (await bench.accept("placement.back_off")).state == "retracted"
    assert (await bench.do("placement.confirm")).decision == "rejected"
    await bench.accept("placement.home")
    assert (await bench.accept("placement.approach")).state == "standoff"
    await bench.accept("placement.confirm")


async def test_a_plan_of_no_pose_is_refused(bench: WorkflowBench) -> None:
    position, quaternion = POSES[0]["position"], POSES[0]["quat_xyzw"]
    await bench.refuse("toolplan.plan", "bad_geometry", position=position, quat_xyzw=[0.0, 0.0, 0.0, 0.0])
    await bench.refuse("toolplan.plan", "bad_geometry", position=position, quat_xyzw=[0.0, 0.0, 0.0, 2.0])
    await bench.refuse("toolplan.plan", "bad_arguments", position=[0.0, 0.0, float("inf")], quat_xyzw=quaternion)
    await bench.refuse("toolplan.plan", "bad_arguments", position=position)
    millimetres = [1000.0 * value for value in position]
    verdict = await bench.refuse("toolplan.plan", "wrong_unit", position=millimetres, quat_xyzw=quaternion)
    assert verdict.reason is not None
    assert verdict.reason.fields["limit"] == 1.0


async def test_unreachable_pose_is_refused_as_soon_as_it_is_known() -> None:
    far: dict[str, Any] = {"position": [0.0, 0.9, 0.9], "quat_xyzw": POSES[0]["quat_xyzw"]}
    async with open_bench({"registration": {"tre_limit_mm": 100.0}}) as bench:
        await bench.accept("toolplan.plan", **far)
        await bench.connect()
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.accept("digitization.digitize_all")
        await bench.accept("registration.register")
        await bench.refuse("placement.approach", "unreachable")
        await bench.refuse("toolplan.plan", "unreachable", **far)
        await bench.accept("toolplan.plan", **POSES[0])
        await bench.accept("placement.approach")


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


async def test_a_retreat_that_would_lead_towards_the_body_is_refused(bench: WorkflowBench) -> None:
    await bench.to_placed()
    assert bench.cell.joints is not None
    bench.cell.initial_joints = bench.cell.joints.positions
    verdict = await bench.refuse("placement.to_initial", "distance_shrinks")
    assert verdict.reason is not None
    assert verdict.reason.fields["shrinks"] > 0.05
    assert bench.states["placement"] == "placed"


async def test_a_retreat_heeds_where_the_body_is_now(bench: WorkflowBench) -> None:
    """A posture that was clear of the body while it was away is not gone to once the body is back."""
    await bench.to_standoff()
    assert bench.cell.joints is not None
    standoff = bench.cell.joints.positions
    await bench.accept("placement.home")
    bench.cell.initial_joints = standoff
    await bench.scene.move_body((0.0, 5.0, 0.0))
    await bench.clock.sleep(0.5)
    await bench.accept("placement.to_initial")
    await bench.accept("placement.home")
    await bench.scene.move_body((0.0, -5.0, 0.0))
    await bench.clock.sleep(0.5)
    await bench.refuse("placement.to_initial", "distance_shrinks")


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


@pytest.mark.parametrize("name", ["placement.approach", "placement.confirm", "placement.nudge"])
async def test_motion_towards_an_unseen_body_is_held_without_a_latch(name: str) -> None:
    async with open_bench({"motion": {"linear_velocity": 0.02, "near_velocity": 0.01}}) as bench:
        await (bench.register() if name == "placement.approach" else bench.to_standoff())
        arguments = {"translation": [0.0, 0.0, 0.019]} if name == "placement.nudge" else {}
        async with bench.moving(name, faster_than=0.005, **arguments) as motion:
            await bench.scene.occlude("body_ref", True)
            hidden = bench.clock.monotonic()
            verdict = await motion
        assert verdict.reason is not None
        assert (verdict.decision, verdict.reason.code, verdict.state) == ("failed", "body_not_seen", "held")
        assert bench.clock.monotonic() - hidden < 0.8, "0.5 s, and the time to brake"
        assert not bench.dispatcher.snapshot().latched
        assert bench.speed() < 1e-3
        # A retreat needs nobody to see the body.
        await bench.accept("placement.back_off")


async def test_a_body_hidden_for_a_moment_holds_nothing() -> None:
    async with open_bench({"motion": {"linear_velocity": 0.02, "near_velocity": 0.01}}) as bench:
        await bench.register()
        async with bench.moving("placement.approach", faster_than=0.005) as approach:
            for _ in range(3):
                await bench.scene.occlude("body_ref", True)
                await bench.clock.sleep(0.35)
                await bench.scene.occlude("body_ref", False)
                await bench.clock.sleep(0.1)
            assert (await approach).decision == "accepted"


async def test_how_long_a_body_may_be_hidden_is_configured() -> None:
    slow = {"motion": {"linear_velocity": 0.02, "near_velocity": 0.01}, "tracking": {"unseen": 2.0}}
    async with open_bench(slow) as bench:
        await bench.register()
        async with bench.moving("placement.approach", faster_than=0.005) as approach:
            await bench.scene.occlude("body_ref", True)
            await bench.clock.sleep(1.5)
            await bench.scene.occlude("body_ref", False)
            assert (await approach).decision == "accepted"


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


async def test_the_robot_is_not_disconnected_near_the_patient(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    for name in ("robot.disconnect", "registration.reinit", "toolplan.reinit", "placement.reinit"):
        await bench.refuse(name, "tool_near_patient")
    await bench.accept("placement.home")
    await bench.accept("robot.disconnect")


async def test_locating_tells_near_from_clear() -> None:
    near = {"arm": {"home": [0.0, 0.35, 0.0, -1.5, 0.0, 1.2, -1.57]}}
    async with open_bench() as bench:
        await bench.connect()
        assert bench.states["placement"] == "retracted"
    async with open_bench({"placement": {"clearance": 2.0}}, near) as bench:
        await bench.connect()
        assert bench.states["placement"] == "held"
        assert (await bench.do("placement.home")).decision == "rejected"


async def test_locating_needs_the_tracker_to_see_tool_and_body(bench: WorkflowBench) -> None:
    await bench.scene.occlude("coil", True)
    await bench.clock.sleep(1.0)
    await bench.accept("robot.connect")
    await bench.until(lambda: any(verdict.operation == "locate" for verdict in bench.recorder.verdicts))
    located = bench.recorder.verdicts[-1]
    assert (located.decision, located.state) == ("failed", "unknown")
    assert bench.states["placement"] == "unknown"
    await bench.scene.occlude("coil", False)
    await bench.clock.sleep(0.2)
    assert (await bench.accept("placement.locate")).state == "retracted"


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


async def test_confirm_keeps_the_nudge_at_the_standoff(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.accept("placement.nudge", translation=[0.005, 0.0, 0.0])
    verdict = await bench.accept("placement.confirm")
    assert verdict.result is not None
    planned, measured = (np.array(verdict.result[pose]["position"]) for pose in ("planned", "measured"))
    assert np.linalg.norm(measured - planned) == pytest.approx(0.005, abs=0.0005)
    assert verdict.result["translation_error"] < 0.0005
    before = bench.cell.image_from_coil(bench.data)
    await bench.accept("placement.nudge", translation=[0.0, 0.001, 0.0])
    assert distance(bench.cell.image_from_coil(bench.data), before) == pytest.approx(0.001, abs=0.0005)


async def test_retracted_means_clear_of_the_body(bench: WorkflowBench) -> None:
    """Beside the axis of its plan, and after another plan, a retreat goes on until the tool is clear."""
    clearance = bench.cell.settings.placement.clearance
    await bench.to_placed()
    await bench.accept("placement.nudge", translation=[0.015, 0.0, 0.0])
    assert (await bench.accept("placement.back_off")).state == "retracted"
    assert distance_from_body(bench.cell, bench.data) > clearance
    await bench.accept("placement.approach")
    await bench.accept("toolplan.plan", **POSES[1])
    assert bench.states["placement"] == "held"
    assert (await bench.accept("placement.back_off")).state == "retracted"
    assert distance_from_body(bench.cell, bench.data) > clearance


async def test_a_retreat_ends_clear_of_the_body_or_is_refused(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    bench.cell.initial_joints = bench.cell.posture().tolist()
    await bench.refuse("placement.to_initial", "not_clear")
    assert bench.states["placement"] == "standoff"


async def test_a_retreat_waits_for_nothing_on_other_branches(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.accept("toolplan.plan", **POSES[1])
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


async def test_way_to_the_standoff_avoids_the_body_without_a_surface() -> None:
    bare = {"body": {"surface": ""}, "placement": {"clearance": 0.14}}
    async with open_bench(bare) as bench:
        await bench.register()
        await bench.accept("toolplan.plan", **POSES[8])
        await bench.accept("placement.approach")
        beside = bench.cell.posture().tolist()
    async with open_bench(bare, {"arm": {"home": beside}}) as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.accept("digitization.digitize_all")
        await bench.accept("registration.register")
        await bench.connect()
        assert bench.states["placement"] == "retracted"
        await bench.accept("toolplan.plan", **POSES[11])
        verdict = await bench.refuse("placement.approach", "path_near_body")
        assert verdict.reason is not None
        assert verdict.reason.fields["distance"] < 0.06, "the head is more than 60 mm thick there"
        assert verdict.reason.fields["limit"] == pytest.approx(0.153, abs=0.01)
