"""What the procedure does when a device fails: the rows S and B of the fault catalogue on the simulated cell.

Each fault is brought about by its name, as anybody else would do it. The bench hears the robot's events, watches the
reference, and believes poses within the limits of the daemon.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import numpy as np
import pytest

from pcmrs.devices.jumps import PoseLimits
from pcmrs.devices.poses import PoseFeed
from pcmrs.dispatcher import Workflow
from pcmrs.messages import Command, DeviceEvent
from pcmrs.service.watches.reference import ReferenceWatch
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs_sim.robot import SimRobot
from tests.unit.workflows.workflow_bench import AT_REST, WorkflowBench, open_bench

Faults = dict[str, Any]
"""Arguments of a fault."""


@asynccontextmanager
async def guarded(
    procedure: Faults | None = None, *, workflow: str | Workflow[Cell, PlacementData] = "ratms"
) -> AsyncIterator[WorkflowBench]:
    # As often as usual: limits of speed tell a jump from a motion only between frames that are near enough.
    rates = {"tracker": {"rate_hz": 60.0}, "arm": {"state_rate_hz": 100.0}}
    async with open_bench(procedure, rates, workflow=workflow) as bench:
        settings = bench.cell.settings
        limits = settings.tracking
        believed = PoseLimits(limits.error_mm / 1000.0, limits.speed, limits.turn, limits.steady)
        bench.cell.poses = PoseFeed(bench.clock, settings.max_pose_age, believed)
        await bench.until(lambda: bench.cell.poses.seen("coil"))
        watches = [
            asyncio.create_task(ReferenceWatch(bench.cell, bench.dispatcher).run()),
            asyncio.create_task(_hear(bench)),
        ]
        try:
            yield bench
        finally:
            for watch in watches:
                watch.cancel()
                with suppress(asyncio.CancelledError):
                    await watch


async def _hear(bench: WorkflowBench) -> None:
    async for event in bench.robot.events():
        bench.dispatcher.report_later(event)


@pytest.fixture
async def bench() -> AsyncIterator[WorkflowBench]:
    async with guarded() as bench:
        yield bench


@pytest.fixture
async def following(bench: WorkflowBench) -> WorkflowBench:
    """A tool that follows the head, and counts as aligned."""
    await bench.to_placed()
    await bench.accept("placement.follow")
    await bench.until(lambda: bench.states["alignment"] == "1")
    return bench


async def stands(bench: WorkflowBench) -> None:
    """The arm truly stands, and does not start again by itself."""
    robot = bench.robot
    assert isinstance(robot, SimRobot)
    await bench.clock.sleep(0.5)
    before = (await bench.scene.truth()).tracker_from_coil.position
    await bench.clock.sleep(1.0)
    after = (await bench.scene.truth()).tracker_from_coil.position
    assert np.linalg.norm(np.subtract(after, before)) < 1e-4


def reported(bench: WorkflowBench) -> list[str]:
    return [each.code for each in bench.published if isinstance(each, DeviceEvent)]


# -- the tracker ------------------------------------------------------------------------------------------------

UNSEEN: list[tuple[str, Faults]] = [
    ("occlude", {"body": "coil"}),
    ("frame_frozen", {}),
    ("tracker_absent", {}),
    ("phantom_marker", {"body": "coil"}),
    ("tool_swap", {"first": "coil", "second": "body_ref"}),
    ("wrong_tool", {"body": "coil"}),
]
"""One of each kind; `tests/unit/sim/test_tracker_faults.py` has them all, and why no pose is believed."""


@pytest.mark.parametrize(("fault", "arguments"), UNSEEN)
async def test_rejected_pose_lets_nothing_move_to_the_body(bench: WorkflowBench, fault: str, arguments: Faults) -> None:
    await bench.to_standoff()
    await bench.scene.inject(fault, arguments | {"on": True})
    await bench.clock.sleep(1.0)
    await bench.refuse("placement.confirm", "pose_stale")
    await stands(bench)
    await bench.scene.inject(fault, arguments | {"on": False})
    await bench.clock.sleep(1.0)
    await bench.accept("placement.confirm")


@pytest.mark.parametrize(("fault", "arguments"), UNSEEN)
async def test_rejected_pose_ends_following(following: WorkflowBench, fault: str, arguments: Faults) -> None:
    await following.scene.inject(fault, arguments | {"on": True})
    await held(following)
    await following.scene.inject(fault, arguments | {"on": False})
    await following.clock.sleep(1.0)
    assert following.states["placement"] == "held", "nothing goes on by itself"
    await following.accept("robot.acknowledge")
    await following.accept("placement.back_off")


@pytest.mark.parametrize(("body", "millimetres"), [("coil", 15.0), ("coil", 60.0), ("body_ref", 15.0)])
async def test_a_jump_is_not_followed(following: WorkflowBench, body: str, millimetres: float) -> None:
    before = (await following.scene.truth()).tracker_from_coil.position
    await following.scene.inject("pose_jump", {"body": body, "millimetres": millimetres})
    await held(following)
    after = (await following.scene.truth()).tracker_from_coil.position
    assert np.linalg.norm(np.subtract(after, before)) < 0.001


async def test_five_frames_a_second_are_too_few_to_follow_by(following: WorkflowBench) -> None:
    await following.scene.inject("tracker_rate", {"hertz": 5.0})
    await held(following)
    assert following.cell.poses.rate_hz("coil") < 10.0


async def held(bench: WorkflowBench) -> None:
    await bench.until(lambda: bench.states["placement"] != "following")
    assert (bench.states["placement"], bench.states["alignment"]) == ("held", "0")
    assert bench.dispatcher.snapshot().latched
    await stands(bench)


# -- the patient ------------------------------------------------------------------------------------------------


async def test_a_bumped_reference_takes_the_registration_back(bench: WorkflowBench) -> None:
    await bench.to_placed()
    await bench.scene.inject("bump_reference", {"millimetres": 4.0})
    await bench.until(lambda: bench.states["registration"] == "100")
    assert bench.states["placement"] == "held"
    assert bench.dispatcher.snapshot().latched
    assert bench.data.registered is None


@pytest.fixture
async def armed() -> AsyncIterator[WorkflowBench]:
    """Placed, aligned, armed at 50 %, with the interval behind."""
    async with guarded({"alignment": {"off_time": 30.0}}, workflow="ratms_threshold") as bench:
        await bench.to_placed()
        await bench.accept("stimulation.set_ceiling", percent=80.0, operator="Dr Hand")
        await bench.accept("stimulation.set_intensity", percent=50.0)
        await bench.accept("stimulation.arm")
        await bench.until(lambda: bench.states["alignment"] == "1")
        await bench.clock.sleep(5.0)
        yield bench


async def test_a_head_at_86_mm_per_second_gets_no_pulse(armed: WorkflowBench) -> None:
    """The gate of alignment tolerates it for 30 s here; the pulse does not."""
    await armed.scene.inject("dash_head", {"millimetres_per_second": 86.0})
    await armed.clock.sleep(0.35)
    verdict = await armed.do("stimulation.fire")
    assert verdict.reason is not None
    assert (verdict.decision, verdict.reason.code) == ("rejected", "coil_off_target")
    assert armed.data.given == 0  # type: ignore[attr-defined]


@pytest.mark.parametrize(("fault", "arguments"), [*UNSEEN[:2], ("tracker_rate", {"hertz": 5.0})])
async def test_rejected_pose_allows_no_pulse(armed: WorkflowBench, fault: str, arguments: Faults) -> None:
    await armed.scene.inject(fault, arguments if "hertz" in arguments else arguments | {"on": True})
    await armed.clock.sleep(1.0)
    await armed.refuse("stimulation.fire", "pose_stale")
    assert armed.data.given == 0  # type: ignore[attr-defined]


async def test_a_threshold_that_no_pulse_reaches_is_refused(armed: WorkflowBench) -> None:
    await armed.scene.inject("no_mep", {"on": True})
    await armed.accept("threshold.begin")
    result: dict[str, Any] = {}
    while armed.states["threshold"] == "hunting":
        result = (await armed.accept("threshold.pulse")).result or {}
        assert not result["mep"]["present"]
        await armed.clock.sleep(5.0)
    assert armed.states["threshold"] == "none"
    assert result["refusal"]
    assert armed.data.threshold is None  # type: ignore[attr-defined]


# -- the robot ----------------------------------------------------------------------------------------------------

BRAKED: list[tuple[str, Faults, Faults, str]] = [
    ("e_stop", {"on": True}, {"on": False}, "drives_off"),
    ("change_mode", {"on": True}, {"on": False}, "drives_off"),
    ("close_brakes", {"on": True}, {"on": False}, "drives_off"),
    ("offset_joint", {"joint": 3, "angle": 0.05}, {"joint": 3, "angle": 0.0}, "pose_differs"),
    ("push_tool", {"force": 40.0}, {"force": 0.0}, "force_limit"),
]
"""A fault, how it begins and ends, and the event that tells."""


@pytest.mark.parametrize(("fault", "begin", "end", "event"), BRAKED)
async def test_a_motion_that_fails_at_the_robot_is_held_and_latched(
    bench: WorkflowBench, fault: str, begin: Faults, end: Faults, event: str
) -> None:
    await bench.register()
    async with bench.moving("placement.approach") as approach:
        await bench.scene.inject(fault, begin)
        verdict = await approach
    assert (verdict.decision, verdict.state) == ("failed", "held")
    await bench.until(lambda: event in reported(bench))
    assert bench.dispatcher.snapshot().latched
    assert bench.speed() < AT_REST
    await stands(bench)
    await bench.refuse("placement.back_off", "latched")
    await bench.scene.inject(fault, end)
    await bench.clock.sleep(1.0)
    assert bench.states["placement"] == "held", "nothing goes on by itself"
    await bench.accept("robot.acknowledge")
    assert (await bench.accept("placement.back_off")).state == "retracted"


@pytest.mark.parametrize(("fault", "begin", "end", "event"), BRAKED)
async def test_fault_while_following_holds_and_latches(
    following: WorkflowBench, fault: str, begin: Faults, end: Faults, event: str
) -> None:
    await following.scene.inject(fault, begin)
    await following.until(lambda: event in reported(following))
    await held(following)
    await following.scene.inject(fault, end)
    await following.clock.sleep(1.0)
    await following.accept("robot.acknowledge")
    await following.accept("placement.back_off")


@pytest.mark.parametrize("fault", ["e_stop", "change_mode", "close_brakes"])
async def test_without_drives_there_is_no_motion_and_the_way_out_stays(bench: WorkflowBench, fault: str) -> None:
    await bench.to_standoff()
    await bench.scene.inject(fault, {"on": True})
    await bench.until(lambda: bench.dispatcher.snapshot().latched)
    await bench.accept("robot.acknowledge")
    await bench.refuse("placement.confirm", "device_failed", "failed")
    assert bench.states["placement"] == "held"
    await bench.scene.inject(fault, {"on": False})
    await bench.accept("placement.back_off")


async def test_a_force_over_the_limit_at_rest_holds_the_tool(bench: WorkflowBench) -> None:
    await bench.to_placed()
    await bench.scene.inject("push_tool", {"force": 40.0})
    await bench.until(lambda: bench.states["placement"] == "held")
    assert bench.dispatcher.snapshot().latched
    assert "force_limit" in reported(bench)


async def test_an_interrupted_motion_has_failed(bench: WorkflowBench) -> None:
    await bench.register()
    async with bench.moving("placement.approach") as approach:
        await bench.scene.inject("interrupt", {})
        verdict = await approach
    assert (verdict.decision, verdict.state) == ("failed", "held")
    assert verdict.reason is not None
    assert "interrupted" in verdict.reason.text
    await stands(bench)


@pytest.mark.parametrize("fault", ["cut_robot", "silence_robot", "drop_client"])
async def test_unanswered_motion_is_unknown_and_never_repeated(bench: WorkflowBench, fault: str) -> None:
    await bench.register()
    begin: Faults = {} if fault == "drop_client" else {"on": True}
    async with bench.moving("placement.approach") as approach:
        await bench.scene.inject(fault, begin)
        verdict = await approach
    assert (verdict.decision, verdict.state) == ("unknown", "unknown")
    if fault != "drop_client":  # of which the robot tells; the others only the daemon's watch can tell
        await bench.dispatcher.report(DeviceEvent(device="robot", code="link_lost", text="Silent.", danger=True))
        assert (await bench.do("robot.connect")).decision == "unknown"
        await bench.scene.inject(fault, {"on": False})
    await bench.until(lambda: bench.states["robot"] == "0")
    assert bench.dispatcher.snapshot().latched
    await stands(bench)
    await bench.connect()
    await stands(bench)
    assert bench.recorder.rows.count(("intent", "approach")) == 1
    await bench.refuse("placement.approach", "latched")


async def test_arm_moved_while_disconnected_is_located_again(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.scene.inject("drop_client", {})
    await bench.until(lambda: bench.states["robot"] == "0")
    assert bench.states["placement"] == "unknown"
    await stands(bench)
    await bench.scene.inject("guide_by_hand", {"joint": 1, "angle": 0.4})
    await bench.clock.sleep(4.0)
    await bench.connect()
    assert bench.states["placement"] in ("held", "retracted")
    assert bench.cell.joints is not None
    assert np.allclose(bench.cell.joints.positions, (await bench.robot.joints()).positions, atol=1e-3)
    await bench.accept("robot.acknowledge")
    if bench.states["placement"] == "held":
        await bench.accept("placement.back_off")
    await bench.accept("placement.home")


async def test_a_step_that_raises_leaves_the_state(bench: WorkflowBench) -> None:
    await bench.scene.inject("refuse_robot", {"on": True})
    verdict = await bench.do("robot.connect")
    assert verdict.reason is not None
    assert (verdict.decision, verdict.state, verdict.reason.code) == ("failed", "0", "device_refused")
    assert bench.states["robot"] == "0"
    await bench.scene.inject("refuse_robot", {"on": False})
    await bench.connect()


async def test_a_pose_out_of_reach_is_refused(bench: WorkflowBench) -> None:
    await bench.register()
    await bench.scene.inject("shift_body", {"millimetres": 850.0})
    await bench.clock.sleep(1.0)
    await bench.refuse("placement.approach", "unreachable")
    await stands(bench)
    await bench.scene.inject("shift_body", {"millimetres": -850.0})
    await bench.clock.sleep(1.0)
    await bench.accept("placement.approach")


async def test_set_point_after_the_reconnection_is_dropped(following: WorkflowBench) -> None:
    robot = following.robot
    assert isinstance(robot, SimRobot)
    await following.scene.inject("late_set_point", {"on": True})
    await following.scene.inject("drop_client", {})
    await following.until(lambda: following.states["robot"] == "0")
    await stands(following)
    dropped = robot.sessions.dropped
    await following.connect()
    assert robot.sessions.dropped == dropped + 1
    await stands(following)


async def test_a_command_that_comes_twice_moves_once(bench: WorkflowBench) -> None:
    await bench.register()
    command = Command(id="once", branch="placement", operation="approach", source="test:user", arguments={})
    first, second = await asyncio.gather(bench.dispatcher.submit(command), bench.dispatcher.submit(command))
    assert first == second == await bench.dispatcher.submit(command)
    assert bench.recorder.rows.count(("intent", "approach")) == 1


async def test_set_points_that_come_twice_are_followed_once(following: WorkflowBench) -> None:
    robot = following.robot
    assert isinstance(robot, SimRobot)
    await following.scene.inject("double_commands", {"on": True})
    await following.clock.sleep(3.0)
    assert robot.sessions.dropped > 100
    assert following.states["placement"] == "following"
    assert following.states["alignment"] == "1"
