"""A plan is a pose that the arm can reach outside the zones; a previous one is planned again."""

from __future__ import annotations

from typing import Any

import numpy as np

from pcmrs.workflows._placement import planned_pose
from pcmrs.workflows.toolplan import ToolPose, pose_of, standoff_postures
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, WorkflowBench, open_bench
from tests.unit.workflows.zone_bench import lamp


async def test_another_posture_is_taken_where_the_first_is_in_a_zone() -> None:
    async with open_bench() as bench:
        await bench.to_standoff()
        first = bench.cell.posture()
        elbow = bench.cell.arm.joint_origins(first)[3]
        seen = bench.cell.image_from_tool_tip(bench.data).translation
    async with open_bench(lamp(elbow, 0.03)) as bench:
        await bench.to_standoff()
        assert np.abs(bench.cell.posture() - first).max() > 0.1
        assert np.linalg.norm(bench.cell.image_from_tool_tip(bench.data).translation - seen) < 0.002


async def test_nearest_of_all_refused_postures_gives_the_reason() -> None:
    """Of five postures four have the elbow in a box: what is wrong with the way of the other is the reason."""
    async with open_bench() as bench:
        await bench.register()
        postures = list(standoff_postures(bench.run("placement.approach"), pose_of(ToolPose(**POSES[6]))))
        elbows = [bench.cell.arm.joint_origins(posture)[3] for posture in postures]
    assert len(elbows) == 5
    boxes = [
        {"name": f"lamp_{number}", "pose": {"position": elbow.tolist()}, "size": [0.01] * 3}
        for number, elbow in enumerate(elbows[1:])
    ]
    narrow = {"zones": {"cone_height": 0.2, "cone_half_angle_deg": 5.0, "boxes": boxes}}
    async with open_bench(narrow) as bench:
        await bench.register()
        await bench.accept("toolplan.plan", **POSES[6])
        run = bench.run("placement.approach")
        (posture,) = standoff_postures(run, planned_pose(bench.data))
        assert np.abs(posture - postures[0]).max() < 0.02
        await bench.refuse("placement.approach", "outside_cone")


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


async def test_last_plan_is_taken_back_under_its_own_id(bench: WorkflowBench) -> None:
    await bench.refuse("toolplan.use_previous", "no_previous_plan")
    await bench.accept("toolplan.plan", **POSES[0])
    await bench.accept("toolplan.plan", **POSES[1])
    planned, plan_id = bench.data.plan, bench.data.plan_id
    await bench.accept("toolplan.clear")
    assert bench.data.plan is None
    await bench.accept("toolplan.use_previous")
    assert bench.states["toolplan"] == "1"
    assert bench.data.plan == planned
    assert bench.data.plan_id not in (None, plan_id), "what was approached by the other id is not at this plan"


async def test_a_plan_that_could_not_be_made_now_is_not_taken_back(bench: WorkflowBench) -> None:
    """The registration that is in force now is too inaccurate at the plan of the one before."""
    await bench.accept("toolplan.plan", position=[0.0, 0.6, 0.5], quat_xyzw=POSES[0]["quat_xyzw"])
    await bench.accept("toolplan.clear")
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.digitize_all")
    await bench.accept("registration.register")
    await bench.refuse("toolplan.use_previous", "tre_too_large")
