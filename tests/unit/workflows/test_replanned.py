"""From target to target: a new plan leaves the position known, and the tool goes on without a full retreat."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.messages import JointTrajectory, MotionResult
from pcmrs.spatial import Transform, distance
from pcmrs.workflows._placement import planned_pose
from pcmrs.workflows.data import as_transform
from tests.unit.workflows.workflow_bench import POSES, WorkflowBench, open_bench

STANDOFF = 0.070


def beside(pose: dict[str, Any], millimetres: float) -> dict[str, Any]:
    """A pose of the coil a little further along its own x axis, as the next point of a grid."""
    image_from_coil = Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"])
    shifted = image_from_coil @ Transform(np.eye(3), np.array([millimetres / 1000.0, 0.0, 0.0]))
    return {"position": shifted.translation.tolist(), "quat_xyzw": shifted.quat_xyzw.tolist()}


async def height_over(bench: WorkflowBench, pose: dict[str, Any]) -> float:
    """Height of the tool over a target, along the axis of the target, m, as the tracker sees it."""
    target = Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"])
    return float((target.inverse() @ bench.cell.image_from_tool_tip(bench.data)).translation[2])


async def least_heights(bench: WorkflowBench, name: str, pose: dict[str, Any]) -> tuple[float, float]:
    """Perform a motion; return the greatest height over a target on the way, and the greatest distance from it, m."""
    target = Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"])
    task, heights, distances = asyncio.create_task(bench.do(name)), [0.0], [0.0]
    while not task.done():
        seen = bench.cell.image_from_tool_tip(bench.data)
        heights.append(float((target.inverse() @ seen).translation[2]))
        distances.append(distance(target, seen))
        await bench.clock.sleep(0.02)
    assert task.result().decision == "accepted", task.result().reason
    return max(heights), max(distances)


async def true_distance(bench: WorkflowBench) -> float:
    """Distance of the contact point from the plan mapped by the registration, m, as it truly is."""
    truth = await bench.scene.truth()
    assert bench.data.registered is not None
    image_from_body_ref = as_transform(bench.data.registered.body_ref_from_image).inverse()
    image_from_tracker = image_from_body_ref @ as_transform(truth.tracker_from_body_ref).inverse()
    return distance(planned_pose(bench.data), image_from_tracker @ as_transform(truth.tracker_from_coil))


@pytest.mark.parametrize("state", ["standoff", "placed"])
async def test_the_next_target_is_reached_by_the_last_standoff(bench: WorkflowBench, state: str) -> None:
    await (bench.to_standoff() if state == "standoff" else bench.to_placed())
    await bench.accept("toolplan.plan", **beside(POSES[0], 20.0))
    assert bench.states["placement"] == "replanned"
    highest, farthest = await least_heights(bench, "placement.approach", POSES[0])
    assert bench.states["placement"] == "standoff"
    assert highest > STANDOFF - 0.003, "it left along its axis"
    assert farthest < 0.120, "it did not retreat until it was clear of the head"
    await bench.accept("placement.confirm")
    assert await true_distance(bench) < 0.001


async def test_a_plan_twice_changed_still_leaves_by_the_place_it_is_at(bench: WorkflowBench) -> None:
    await bench.to_placed()
    for millimetres in (15.0, -15.0):
        await bench.accept("toolplan.plan", **beside(POSES[0], millimetres))
        assert bench.states["placement"] == "replanned"
    highest, _ = await least_heights(bench, "placement.approach", POSES[0])
    assert highest > STANDOFF - 0.003
    await bench.accept("placement.confirm")
    assert await true_distance(bench) < 0.001


@pytest.mark.parametrize("name", ["home", "to_initial", "back_off"])
async def test_a_replanned_tool_can_always_be_brought_away(bench: WorkflowBench, name: str) -> None:
    await bench.to_placed()
    await bench.accept("toolplan.plan", **POSES[1])
    assert (await bench.accept(f"placement.{name}")).state == "retracted"


async def test_only_a_complete_new_plan_keeps_the_position(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.accept("toolplan.use_previous")
    assert bench.states["placement"] == "replanned"
    await bench.accept("toolplan.clear")
    assert bench.states["placement"] == "held"
    await bench.accept("toolplan.plan", **POSES[0])
    assert bench.states["placement"] == "held", "what is held is not known again by a plan"


@pytest.mark.parametrize("change", ["registration.clear_registration", "registration.register", "robot.disconnect"])
async def test_a_replanned_tool_is_held_when_the_registration_changes(bench: WorkflowBench, change: str) -> None:
    await bench.to_standoff()
    await bench.accept("toolplan.plan", **POSES[1])
    verdict = await bench.do(change)
    expected = "replanned" if change == "robot.disconnect" else "held"
    assert (verdict.decision == "rejected") == (expected == "replanned")
    assert bench.states["placement"] == expected


async def test_a_plan_while_stop_is_latched_holds(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.dispatcher.stop("test:operator")
    await bench.accept("toolplan.plan", **POSES[1])
    assert bench.states["placement"] == "held"
    await bench.accept("robot.acknowledge")
    assert (await bench.do("placement.approach")).decision == "rejected"
    assert (await bench.accept("placement.back_off")).state == "retracted"


async def test_stop_on_the_way_to_the_next_target_holds(bench: WorkflowBench) -> None:
    await bench.to_placed()
    await bench.accept("toolplan.plan", **beside(POSES[0], 20.0))
    async with bench.moving("placement.approach", faster_than=0.02) as approach:
        await bench.dispatcher.stop("test:operator")
    assert approach.result().decision == "failed"
    assert bench.states["placement"] == "held"
    await bench.clock.sleep(0.5)
    assert bench.speed() < 1e-3


async def test_the_onward_way_is_planned_again_where_the_head_is(bench: WorkflowBench) -> None:
    await bench.to_placed()
    await bench.accept("toolplan.plan", **beside(POSES[0], 20.0))
    async with bench.moving("placement.approach", faster_than=0.02):
        await bench.scene.move_body((0.0, 0.004, 0.0))
    assert bench.states["placement"] == "standoff"
    seen = bench.cell.image_from_tool_tip(bench.data)
    assert distance(planned_pose(bench.data) @ Transform(np.eye(3), np.array([0.0, 0.0, STANDOFF])), seen) < 0.002


async def test_a_target_behind_the_head_is_refused_with_a_remedy(bench: WorkflowBench) -> None:
    await bench.to_placed()
    refused = []
    for pose in POSES[1:]:
        await bench.accept("toolplan.plan", **pose)
        verdict = await bench.do("placement.approach")
        if verdict.decision == "rejected":
            refused.append(verdict)
            break
        assert verdict.decision == "accepted", verdict.reason
    for verdict in refused:
        assert verdict.reason is not None
        assert verdict.reason.code in ("path_near_body", "zone_violated", "outside_cone")
        assert bench.states["placement"] == "replanned"
        assert (await bench.accept("placement.home")).state == "retracted"


async def test_confirm_at_the_target_follows_a_head_that_moved(bench: WorkflowBench) -> None:
    await bench.to_placed()
    await bench.scene.move_body((0.0, 0.006, 0.0))
    await bench.clock.sleep(0.5)
    assert await true_distance(bench) > 0.004
    assert (await bench.accept("placement.confirm")).state == "placed"
    assert await true_distance(bench) < 0.001


async def test_execute_at_the_standoff_follows_a_head_that_moved(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.scene.move_body((0.0, 0.030, 0.0))
    await bench.clock.sleep(0.5)
    assert (await bench.accept("placement.approach")).state == "standoff"
    assert (await bench.accept("placement.confirm")).state == "placed"
    assert await true_distance(bench) < 0.001


async def test_a_head_that_moved_far_needs_a_retreat_first(bench: WorkflowBench) -> None:
    await bench.to_placed()
    await bench.scene.move_body((0.0, 0.030, 0.0))
    await bench.clock.sleep(0.5)
    verdict = await bench.refuse("placement.confirm", "realignment_too_large")
    assert verdict.reason is not None
    assert "back off" in verdict.reason.text.lower()
    assert (await bench.accept("placement.back_off")).state == "retracted"


@pytest.mark.parametrize("drops", [False, True])
async def test_confirm_keeps_or_drops_nudges_as_the_cell_says(drops: bool) -> None:
    async with open_bench({"placement": {"confirm_drops_nudges": drops}}) as bench:
        await bench.to_placed()
        await bench.accept("placement.nudge", translation=[0.0, 0.0, 0.004])
        await bench.accept("placement.confirm")
        assert await bench.true_height() == pytest.approx(0.0 if drops else 0.004, abs=0.0008)
        assert bench.data.nudge_translation == pytest.approx((0.0, 0.0, 0.0 if drops else 0.004))


async def test_a_late_joint_state_does_not_end_the_way(bench: WorkflowBench) -> None:
    """The answer of the first leg overtakes the last joint state of the braking arm."""
    await bench.to_standoff()
    cell = bench.cell
    follow = cell.robot.follow
    late: set[asyncio.Task[None]] = set()

    async def report_late() -> None:
        await bench.clock.sleep(0.03)
        assert cell.joints is not None
        cell.update_joints(msgspec.structs.replace(cell.joints, moving=True))

    async def overtake(trajectory: JointTrajectory) -> MotionResult:
        result = await follow(trajectory)
        late.add(asyncio.create_task(report_late()))
        return result

    cell.robot.follow = overtake  # type: ignore[method-assign]
    for millimetres in (15.0, 0.0, 15.0, 0.0):
        await bench.accept("toolplan.plan", **beside(POSES[0], millimetres))
        await bench.accept("placement.approach")
        assert bench.states["placement"] == "standoff"
    await asyncio.gather(*late)
