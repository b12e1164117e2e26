"""Stop, and a robot that falls silent, in every motion."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest

from pcmrs.devices.standstill import MOVED
from pcmrs.messages import DeviceEvent
from pcmrs.workflows.data import as_transform
from tests.unit.workflows.workflow_bench import AT_REST, POSES, WorkflowBench, open_bench

Prepare = Callable[[WorkflowBench], Awaitable[Any]]
MOTIONS: list[tuple[str, Prepare, dict[str, Any]]] = [
    ("placement.approach", WorkflowBench.register, {}),
    ("placement.confirm", WorkflowBench.to_standoff, {}),
    ("placement.nudge", WorkflowBench.to_standoff, {"translation": [0.0, 0.0, 0.015]}),
    ("placement.back_off", WorkflowBench.to_placed, {}),
    ("placement.home", WorkflowBench.to_placed, {}),
    ("placement.to_initial", WorkflowBench.to_standoff, {}),
]
LOST = DeviceEvent(device="robot", code="link_lost", text="The robot is silent.", danger=True)


@pytest.mark.parametrize(("name", "prepare", "arguments"), MOTIONS, ids=lambda value: str(value)[10:20])
async def test_stop_holds_every_motion_and_the_way_out_is_back_off(
    bench: WorkflowBench, name: str, prepare: Prepare, arguments: dict[str, Any]
) -> None:
    await prepare(bench)
    async with bench.moving(name, **arguments) as motion:
        await bench.dispatcher.stop("test")
        assert motion.done()
        assert np.abs((await bench.robot.joints()).velocities).max() < AT_REST
        verdict = await motion
    assert verdict.decision == "failed"
    assert verdict.reason is not None
    assert verdict.reason.code == "stopped"
    assert verdict.state == bench.states["placement"] == "held"
    snapshot = bench.dispatcher.snapshot()
    assert snapshot.latched
    assert not snapshot.running
    for other, _, other_arguments in MOTIONS:
        assert (await bench.do(other, **other_arguments)).decision == "rejected"
    await bench.refuse("placement.back_off", "latched")
    await bench.accept("robot.acknowledge")
    ended = (await bench.accept("placement.back_off")).state
    assert ended in ("standoff", "retracted")
    await bench.accept("placement.home")


@pytest.mark.parametrize("prepare", [WorkflowBench.register, WorkflowBench.to_standoff, WorkflowBench.to_placed])
async def test_arm_that_moves_while_nothing_runs_loses_its_place(bench: WorkflowBench, prepare: Prepare) -> None:
    await prepare(bench)
    await bench.dispatcher.report(
        DeviceEvent(device="robot", code=MOVED, text="Joint 3 was displaced by 0.05 rad.", danger=True)
    )
    await bench.until(lambda: bench.states["placement"] == "held")
    await bench.refuse("placement.back_off", "latched")
    await bench.accept("robot.acknowledge")
    assert (await bench.accept("placement.back_off")).state in ("standoff", "retracted")


async def test_stop_at_rest_latches_and_revokes_nothing(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.dispatcher.stop("test")
    assert bench.states["placement"] == "standoff"
    await bench.refuse("placement.confirm", "latched")
    await bench.accept("robot.acknowledge")
    await bench.accept("placement.confirm")


@pytest.mark.parametrize(("name", "prepare", "arguments"), MOTIONS, ids=lambda value: str(value)[10:20])
async def test_nobody_knows_where_a_silent_robot_is(
    bench: WorkflowBench, name: str, prepare: Prepare, arguments: dict[str, Any]
) -> None:
    await prepare(bench)
    async with bench.moving(name, **arguments) as motion:
        await bench.scene.cut_robot(True)
        verdict = await motion
    assert verdict.decision == "unknown"
    assert verdict.state == bench.states["placement"] == "unknown"
    await bench.dispatcher.report(LOST)
    assert bench.states["robot"] == "0"
    assert bench.states["registration"] == "111"
    assert bench.dispatcher.snapshot().latched
    failed = await bench.do("robot.connect")
    assert (failed.decision, failed.state) == ("unknown", "0")
    await bench.scene.cut_robot(False)
    await bench.clock.sleep(1.0)  # the arm brakes by itself when its link is cut
    await bench.connect()
    assert bench.states["placement"] in ("held", "retracted")


async def test_link_lost_at_the_standoff_makes_the_placement_unknown(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.scene.cut_robot(True)
    await bench.dispatcher.report(LOST)
    assert bench.states["robot"] == "0"
    assert bench.states["placement"] == "unknown"
    assert (await bench.do("placement.back_off")).decision == "rejected"


async def test_a_plan_is_not_changed_under_a_motion(bench: WorkflowBench) -> None:
    await bench.register()
    async with bench.moving("placement.approach") as approach:
        for name, arguments in (
            ("toolplan.plan", POSES[1]),
            ("registration.clear_landmarks", {}),
            ("placement.home", {}),
        ):
            await bench.refuse(name, "busy", **arguments)
        assert (await approach).state == "standoff"


async def test_backing_off_leads_home_if_a_joint_limit_cuts_it_short() -> None:
    """Joint 6 is a hundredth of a radian before its limit, and the straight way back would turn it farther."""
    at_limit = {"arm": {"home": [-0.264, -0.875, -0.094, -1.749, -0.079, 2.084, -1.042]}}
    async with open_bench(sim=at_limit) as bench:
        truth = await bench.scene.truth()
        coil, body = as_transform(truth.tracker_from_coil), as_transform(truth.tracker_from_body_ref)
        arm, flange_from_tool_tip = bench.cell.arm, bench.cell.flange_from_tool_tip
        base_from_tool_tip = arm.forward(at_limit["arm"]["home"]) @ flange_from_tool_tip
        home_in_coil = (base_from_tool_tip.inverse() @ arm.forward(bench.cell.home) @ flange_from_tool_tip).translation
        away_from_home = -0.2 * home_in_coil / np.linalg.norm(home_in_coil)
        x, y, z = (coil @ away_from_home - body.translation).tolist()
        await bench.scene.move_body((x, y, z))
        await bench.clock.sleep(0.5)
        await bench.connect()
        assert bench.states["placement"] == "held", "the tool is 200 mm from the body"
        await bench.refuse("placement.back_off", "body_not_registered")
        assert (await bench.accept("placement.back_off", confirm=True)).state == "retracted"
        assert bench.cell.joints is not None
        assert bench.cell.joints.positions == pytest.approx(bench.cell.home, abs=2e-3)
