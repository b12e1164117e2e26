"""Femoroplasty on the simulated cell: a femur, a drill guide, and a surgeon who confirms."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pcmrs.errors import RefusalError
from pcmrs.messages import DeviceEvent
from pcmrs.spatial import Transform
from pcmrs.workflows.data import as_transform
from pcmrs.workflows.femoroplasty import Data, check_guide_on_plan, check_guide_pose, guide_pose
from pcmrs_sim.plan import TRAJECTORIES, trajectory
from tests import ROOT
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench

PLAN: dict[str, Any] = json.loads((ROOT / "examples" / "femoroplasty_plan.json").read_text())
ENTRY, TARGET = [0.1190896, 0.0086103, -0.0247955], [0.0652414, 0.0161782, -0.0051043]
TRAJECTORY: dict[str, Any] = {"entry": ENTRY, "target": TARGET}
SURGEON = {"surgeon": "A. Surgeon"}
LOST = DeviceEvent(device="robot", code="link_lost", text="The robot is silent.", danger=True)

coordinate = st.floats(-0.5, 0.5)
points = st.tuples(coordinate, coordinate, coordinate).map(np.array)


@asynccontextmanager
async def open_femur(procedure: dict[str, Any] | None = None) -> AsyncIterator[WorkflowBench]:
    """The guide placed at a planned trajectory of a registered femur."""
    async with open_bench(procedure, workflow="femoroplasty") as bench:
        await bench.accept("treatment.confirm_clear", **SURGEON)
        await bench.connect()
        await bench.accept("registration.plan_landmarks", landmarks=PLAN["landmarks"])
        await bench.accept("digitization.digitize_all")
        registered = await bench.accept("registration.register")
        assert registered.result is not None
        assert registered.result["limit"] == 0.0027
        await bench.accept("toolplan.plan_trajectory", **TRAJECTORY)
        await place(bench)
        yield bench


@pytest.fixture
async def femur() -> AsyncIterator[WorkflowBench]:
    async with open_femur() as bench:
        yield bench


@pytest.fixture
async def exact_femur() -> AsyncIterator[WorkflowBench]:
    """With a guide that is placed to a tenth of a millimetre."""
    async with open_femur({"placement": {"frames": 4, "tolerance_mm": 0.1, "noise_factor": 0.0}}) as bench:
        yield bench


async def place(bench: WorkflowBench) -> None:
    await bench.accept("placement.approach")
    await bench.accept("placement.confirm")


async def drill(bench: WorkflowBench) -> None:
    await bench.accept("treatment.start_drilling", **SURGEON)
    await bench.accept("treatment.confirm_drilled", **SURGEON)


async def drill_and_check(bench: WorkflowBench) -> None:
    await drill(bench)
    await bench.accept("treatment.check_guide")


async def lose_the_robot(bench: WorkflowBench) -> None:
    """And find it again, held where it is."""
    await bench.scene.cut_robot(True)
    await bench.dispatcher.report(LOST)
    assert bench.states["placement"] == "unknown"
    await bench.scene.cut_robot(False)
    await bench.clock.sleep(1.0)
    await bench.connect()
    assert bench.states["placement"] == "held"
    await bench.accept("robot.acknowledge")


async def check_that_nothing_moves(bench: WorkflowBench) -> None:
    for motion in ("back_off", "home", "to_initial"):
        await bench.refuse(f"placement.{motion}", "drill_in_bone")
    await bench.refuse("placement.nudge", "drill_in_bone", translation=[0.0, 0.0, 0.001])
    for leaving in ("robot.disconnect", "registration.reinit", "toolplan.reinit", "placement.reinit"):
        await bench.refuse(leaving, "drill_in_bone")
    await bench.refuse("treatment.reinit", "drill_in_bone", **SURGEON)


async def check_that_nothing_is_planned(bench: WorkflowBench) -> None:
    for name in ("clear_landmarks", "clear_digitization", "clear_registration", "register", "use_previous"):
        await bench.refuse(f"registration.{name}", "drill_in_bone")
    await bench.refuse("registration.plan_landmarks", "drill_in_bone", landmarks=PLAN["landmarks"])
    for name in ("digitize_all", "reuse_previous", "reinit"):
        await bench.refuse(f"digitization.{name}", "drill_in_bone")
    await bench.refuse("digitization.redigitize_one", "drill_in_bone", index=0)
    await bench.refuse("toolplan.plan_trajectory", "drill_in_bone", **TRAJECTORY)
    await bench.refuse("toolplan.clear", "drill_in_bone")


async def test_a_whole_procedure_from_the_landmarks_to_the_injection(femur: WorkflowBench) -> None:
    assert femur.data.plan is not None
    assert as_transform(femur.data.plan).translation.tolist() == ENTRY
    for name, state in (("start_drilling", "drilling"), ("confirm_drilled", "drilled")):
        said = await femur.accept(f"treatment.{name}", **SURGEON)
        assert said.result is not None
        assert (said.state, said.result["surgeon"], said.result["confirmed"]) == (state, "A. Surgeon", name)
        if state == "drilling":
            await check_that_nothing_moves(femur)
            await check_that_nothing_is_planned(femur)
    await femur.refuse("treatment.start_injection", "invalid_in_state", **SURGEON)
    checked = await femur.accept("treatment.check_guide")
    assert checked.result is not None
    assert 0.0 < checked.result["translation_error"] < 0.0005
    await femur.accept("treatment.start_injection", **SURGEON)
    await check_that_nothing_moves(femur)
    await check_that_nothing_is_planned(femur)
    assert (await femur.accept("treatment.confirm_injected", **SURGEON)).state == "injected"
    assert (await femur.accept("placement.home")).state == "retracted"
    assert [verdict.operation for verdict in femur.recorder.verdicts if (verdict.result or {}).get("surgeon")] == [
        "confirm_clear",
        "start_drilling",
        "confirm_drilled",
        "start_injection",
        "confirm_injected",
    ]


async def test_confirmation_needs_a_name_and_drilling_a_guide(femur: WorkflowBench) -> None:
    nameless: list[dict[str, Any]] = [{}, {"surgeon": ""}, {"surgeon": "  "}, {"surgeon": 1}, {"surgeon": "x" * 101}]
    nameless += [{"surgeon": f"A.{letter}Surgeon"} for letter in "\n\r\t\0\x1b\x7f\x85\u2028\u202e"]
    nameless += [{"surgeon": letters} for letters in ("A. Surgeon\n", "\nA. Surgeon", "\u200b", "- -")]
    for arguments in nameless:
        await femur.refuse("treatment.start_drilling", "bad_arguments", **arguments)
        await femur.refuse("treatment.abandon", "bad_arguments", **arguments)
    await femur.accept("placement.back_off")
    await femur.refuse("treatment.start_drilling", "guide_not_placed", **SURGEON)
    given_up = await femur.accept("treatment.abandon", surgeon="Dr. Þóra Ñandú-O’Neill, 医師")
    assert given_up.result == {"surgeon": "Dr. Þóra Ñandú-O’Neill, 医師", "confirmed": "abandon"}


async def test_after_a_restart_nothing_moves_until_the_bone_is_clear() -> None:
    """The surgeon confirms it."""
    async with open_bench(workflow="femoroplasty") as bench:
        await bench.connect()
        await bench.accept("registration.plan_landmarks", landmarks=PLAN["landmarks"])
        await bench.accept("digitization.digitize_all")
        await bench.accept("registration.register")
        await bench.accept("toolplan.plan_trajectory", **TRAJECTORY)
        for leaving in ("placement.approach", "placement.home", "robot.disconnect", "placement.reinit"):
            await bench.refuse(leaving, "drill_in_bone")
        for work in ("start_drilling", "confirm_drilled", "withdraw", "abandon"):
            await bench.refuse(f"treatment.{work}", "invalid_in_state", **SURGEON)
        await bench.refuse("treatment.confirm_clear", "bad_arguments")
        assert (await bench.accept("treatment.confirm_clear", **SURGEON)).state == "ready"
        await bench.refuse("treatment.confirm_clear", "invalid_in_state", **SURGEON)
        await place(bench)


async def test_a_guide_beside_the_plan_is_not_checked(femur: WorkflowBench) -> None:
    await drill(femur)
    await femur.accept("treatment.check_guide")
    await femur.scene.move_body((0.0, 0.003, 0.0))
    await femur.clock.sleep(1.0)
    failed = await femur.refuse("treatment.check_guide", "guide_off", decision="failed")
    assert failed.reason is not None
    assert failed.reason.fields["shift_mm"] == pytest.approx(3.0, abs=0.5)
    assert failed.state == "drilled", "an earlier check is taken back"
    await femur.refuse("treatment.start_injection", "invalid_in_state", **SURGEON)


@pytest.mark.parametrize(
    ("kind", "operation", "state"), [("guide", "start_drilling", "ready"), ("hole", "check_guide", "drilled")]
)
async def test_a_guide_askew_is_refused(kind: str, operation: str, state: str) -> None:
    async with open_femur({"limits": {f"{kind}_error_deg": 1e-6}}) as bench:
        arguments = SURGEON if operation == "start_drilling" else {}
        if not arguments:
            await drill(bench)
        failed = await bench.refuse(f"treatment.{operation}", "guide_off", decision="failed", **arguments)
        assert failed.state == state


async def test_drill_and_needle_go_in_only_where_the_guide_is_now(femur: WorkflowBench) -> None:
    """The body moves after the guide was placed, and again after it was checked."""
    await femur.scene.move_body((0.0, 0.003, 0.0))
    await femur.clock.sleep(1.0)
    failed = await femur.refuse("treatment.start_drilling", "guide_off", decision="failed", **SURGEON)
    assert isinstance(femur.data, Data)
    assert (failed.state, femur.data.hole) == ("ready", None)
    await femur.scene.move_body((0.0, -0.003, 0.0))
    await femur.clock.sleep(1.0)
    await drill_and_check(femur)
    await femur.scene.move_body((0.0, 0.003, 0.0))
    await femur.clock.sleep(1.0)
    failed = await femur.refuse("treatment.start_injection", "guide_off", decision="failed", **SURGEON)
    assert failed.state == "drilled", "the check is taken back"


async def test_work_in_the_bone_does_not_start_unseen(femur: WorkflowBench) -> None:
    await femur.scene.occlude("coil", True)
    await femur.clock.sleep(1.0)
    failed = await femur.refuse("treatment.start_drilling", "pose_missing", decision="failed", **SURGEON)
    assert failed.state == "ready"


async def test_latched_stop_bars_new_steps_but_no_confirmations(femur: WorkflowBench) -> None:
    await femur.dispatcher.stop("test")
    await femur.refuse("treatment.start_drilling", "latched", **SURGEON)
    await femur.accept("robot.acknowledge")
    await femur.accept("treatment.start_drilling", **SURGEON)
    await femur.dispatcher.stop("test")
    assert femur.states["treatment"] == "drilling"
    await femur.accept("treatment.confirm_drilled", **SURGEON)
    await femur.accept("treatment.check_guide")
    await femur.refuse("treatment.start_injection", "latched", **SURGEON)
    await femur.accept("treatment.abandon", **SURGEON)
    await femur.refuse("placement.back_off", "latched")
    await femur.accept("robot.acknowledge")
    await femur.accept("placement.back_off")


async def test_stop_while_the_guide_is_measured_keeps_the_drill_out(femur: WorkflowBench) -> None:
    asking = asyncio.create_task(femur.do("treatment.start_drilling", **SURGEON))
    await femur.until(lambda: bool(femur.dispatcher.snapshot().running))
    await femur.dispatcher.stop("test")
    verdict = await asking
    assert (verdict.decision, verdict.state) == ("failed", "ready")


async def test_a_guide_that_was_moved_must_be_checked_again(femur: WorkflowBench) -> None:
    await drill_and_check(femur)
    await femur.accept("placement.nudge", translation=[0.0005, 0.0, 0.0])
    assert femur.states["treatment"] == "drilled"
    await femur.refuse("treatment.start_injection", "invalid_in_state", **SURGEON)
    await femur.accept("treatment.check_guide")
    await femur.accept("placement.back_off")
    assert femur.states["treatment"] == "drilled"
    await femur.refuse("treatment.check_guide", "guide_not_placed")


async def test_nudges_excuse_nothing(exact_femur: WorkflowBench) -> None:
    """The drill goes where the plan is, within the limit; the needle where the drill went, whatever was nudged."""
    femur = exact_femur
    await femur.accept("placement.nudge", translation=[0.003, 0.0, 0.0])
    await femur.refuse("treatment.start_drilling", "guide_off", decision="failed", **SURGEON)
    await femur.accept("placement.nudge", translation=[-0.0015, 0.0, 0.0])
    await drill_and_check(femur)
    await femur.accept("placement.nudge", translation=[0.003, 0.0, 0.0])
    failed = await femur.refuse("treatment.check_guide", "guide_off", decision="failed")
    assert failed.reason is not None
    assert failed.reason.fields["shift_mm"] == pytest.approx(3.0, abs=0.1)
    await femur.accept("placement.home")
    await place(femur)
    failed = await femur.refuse("treatment.check_guide", "guide_off", decision="failed")
    assert failed.reason is not None
    assert failed.reason.fields["shift_mm"] == pytest.approx(1.5, abs=0.1)
    await femur.accept("placement.nudge", translation=[0.0015, 0.0, 0.0])
    await femur.accept("treatment.check_guide")
    await femur.accept("treatment.start_injection", **SURGEON)


async def test_new_plan_ends_the_work_and_no_hole_is_drilled_twice(femur: WorkflowBench) -> None:
    """The work is that along the old plan."""
    await femur.accept("treatment.start_drilling", **SURGEON)
    await femur.refuse("toolplan.plan_trajectory", "drill_in_bone", **TRAJECTORY)
    assert (await femur.accept("treatment.withdraw", **SURGEON)).state == "ready"
    await drill(femur)
    await femur.accept("toolplan.plan_trajectory", **TRAJECTORY)
    assert (femur.states["treatment"], femur.states["placement"]) == ("abandoned", "replanned")
    await femur.accept("placement.back_off")
    await femur.accept("placement.home")
    await place(femur)
    await femur.refuse("treatment.start_drilling", "invalid_in_state", **SURGEON)
    await femur.refuse("treatment.reinit", "trajectory_in_force", **SURGEON)
    await femur.accept("toolplan.clear")
    await femur.refuse("treatment.reinit", "bad_arguments")
    begun = await femur.accept("treatment.reinit", **SURGEON)
    assert (begun.state, begun.result) == ("ready", {**SURGEON, "confirmed": "reinit"})


async def test_new_registration_ends_the_work_and_injections_stay(femur: WorkflowBench) -> None:
    await drill(femur)
    await femur.accept("registration.register")
    assert femur.states["treatment"] == "abandoned"
    await femur.accept("toolplan.clear")
    await femur.accept("treatment.reinit", **SURGEON)
    await femur.accept("toolplan.plan_trajectory", **TRAJECTORY)
    await femur.accept("placement.back_off")
    await femur.accept("placement.home")
    await place(femur)
    await drill_and_check(femur)
    await femur.accept("treatment.start_injection", **SURGEON)
    await femur.accept("treatment.confirm_injected", **SURGEON)
    await femur.refuse("treatment.reinit", "trajectory_in_force", **SURGEON)
    await femur.accept("toolplan.plan_trajectory", **TRAJECTORY)
    assert femur.states["treatment"] == "injected"


@pytest.mark.parametrize(("said", "state"), [("confirm_drilled", "drilled"), ("withdraw", "ready")])
async def test_a_lost_link_while_drilling_forgets_no_hole(femur: WorkflowBench, said: str, state: str) -> None:
    await femur.accept("treatment.start_drilling", **SURGEON)
    await lose_the_robot(femur)
    assert femur.states["treatment"] == "drilling_interrupted"
    await check_that_nothing_is_planned(femur)
    await femur.refuse("placement.back_off", "drill_in_bone")
    await femur.refuse("robot.disconnect", "drill_in_bone")
    assert (await femur.accept(f"treatment.{said}", **SURGEON)).state == state
    await femur.accept("placement.back_off")
    await femur.accept("placement.home")
    await place(femur)
    if said == "withdraw":
        await drill(femur)
    else:
        await femur.refuse("treatment.start_drilling", "invalid_in_state", **SURGEON)
    await femur.accept("treatment.check_guide")


@pytest.mark.parametrize(("said", "state"), [("confirm_injected", "injected"), ("withdraw", "drilled")])
async def test_a_lost_link_while_injecting_forgets_no_cement(femur: WorkflowBench, said: str, state: str) -> None:
    await drill_and_check(femur)
    await femur.accept("treatment.start_injection", **SURGEON)
    await lose_the_robot(femur)
    assert femur.states["treatment"] == "injecting_interrupted"
    await femur.refuse("treatment.confirm_drilled", "invalid_in_state", **SURGEON)
    assert (await femur.accept(f"treatment.{said}", **SURGEON)).state == state
    await femur.accept("placement.back_off")


async def test_abandoning_is_recorded_and_a_next_trajectory_restarts(femur: WorkflowBench) -> None:
    await femur.accept("treatment.start_drilling", **SURGEON)
    await femur.refuse("treatment.abandon", "invalid_in_state", **SURGEON)
    await femur.accept("treatment.withdraw", **SURGEON)
    given_up = await femur.accept("treatment.abandon", **SURGEON)
    assert (given_up.state, given_up.result) == ("abandoned", {**SURGEON, "confirmed": "abandon"})
    await femur.refuse("treatment.start_drilling", "invalid_in_state", **SURGEON)
    await femur.accept("toolplan.clear")
    assert (await femur.accept("treatment.reinit", **SURGEON)).state == "ready"


async def test_invalid_trajectory_is_refused(femur: WorkflowBench) -> None:
    refused: list[tuple[dict[str, Any], str]] = [
        ({"entry": ENTRY, "target": ENTRY}, "bad_trajectory"),
        ({"entry": [0.1, 0.0, 0.0], "target": [-0.1001, 0.0, 0.0]}, "bad_trajectory"),
        ({"entry": [119.1, 8.6, -24.8], "target": [65.2, 16.2, -5.1]}, "wrong_unit"),
        ({"entry": ENTRY}, "bad_arguments"),
        ({"entry": ENTRY, "target": [0.0, 0.0, float("nan")]}, "bad_arguments"),
        ({"entry": [-0.9, 0.0, 0.0], "target": [-0.95, 0.0, 0.0]}, "unreachable"),
    ]
    for asked, code in refused:
        await femur.refuse("toolplan.plan_trajectory", code, **asked)


@given(points, points)
def test_guide_stands_at_the_entry_pointing_away_from_the_target(entry: Any, target: Any) -> None:
    assume(np.linalg.norm(entry - target) > 0.005)
    pose = guide_pose(entry, target)
    target_in_guide = pose.inverse() @ target
    assert np.allclose(pose.translation, entry)
    assert np.allclose(target_in_guide, (0.0, 0.0, -float(np.linalg.norm(entry - target))), atol=1e-9)
    assert pose.rotation[2, 1] > -1e-9 or abs(pose.rotation[2, 2]) > 0.98


def test_the_example_has_the_poses_that_its_trajectories_mean() -> None:
    for course, pose in zip(TRAJECTORIES, PLAN["poses"], strict=True):
        planned = Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"])
        assert np.allclose(planned.matrix, guide_pose(*trajectory(*course)).matrix, atol=1e-7)


async def test_guide_is_not_checked_against_a_hole_never_measured(femur: WorkflowBench) -> None:
    """A blueprint may let it be asked for: without the place of the hole no needle goes in."""
    await drill(femur)
    run = femur.run("treatment.check_guide")
    await check_guide_pose(run)
    assert run.result["translation_error"] < 0.0005
    run = femur.run("treatment.check_guide")
    run.keep(hole=None)
    with pytest.raises(RefusalError, match="drill through the guide first") as refused:
        await check_guide_pose(run)
    assert refused.value.refusal_code == "no_hole"
    assert run.result == {}


async def test_no_tool_is_measured_in_an_image_that_is_not_registered(femur: WorkflowBench) -> None:
    run = femur.run("treatment.check_guide")
    run.keep(registered=None)
    with pytest.raises(RefusalError) as refused:
        await check_guide_on_plan(run)
    assert refused.value.refusal_code == "not_registered"
    assert run.prepared is None
