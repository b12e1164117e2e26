"""Motion of the tool, and measurement of its pose."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.spatial import Transform, distance
from pcmrs.workflows._motion import placement_errors, pose_result
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench


async def test_confirm_keeps_the_nudge_at_the_standoff(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.accept("placement.nudge", translation=[0.005, 0.0, 0.0])
    verdict = await bench.accept("placement.confirm")
    assert verdict.result is not None
    planned, measured = (np.array(verdict.result[pose]["position"]) for pose in ("planned", "measured"))
    assert np.linalg.norm(measured - planned) == pytest.approx(0.005, abs=0.0005)
    assert verdict.result["translation_error"] < 0.0005
    before = bench.cell.image_from_tool_tip(bench.data)
    await bench.accept("placement.nudge", translation=[0.0, 0.001, 0.0])
    assert distance(bench.cell.image_from_tool_tip(bench.data), before) == pytest.approx(0.001, abs=0.0005)


async def test_a_retreat_that_the_tracker_does_not_see_is_held(bench: WorkflowBench) -> None:
    """The result says why, and backing off again is the way out."""
    await bench.to_placed()
    async with bench.moving("placement.back_off") as retreat:
        await bench.scene.occlude("coil", True)
        ended = await retreat
    assert (ended.decision, ended.state) == ("accepted", "held")
    assert "coil" in (ended.result or {})["not_seen"]
    await bench.scene.occlude("coil", False)
    await bench.clock.sleep(0.2)
    assert (await bench.accept("placement.back_off")).state == "standoff"


async def test_a_motion_stopped_at_the_robot_itself_is_held(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    async with bench.moving("placement.confirm") as confirm:
        await bench.robot.hold()
        verdict = await confirm
    assert verdict.decision == "failed"
    assert verdict.reason is not None
    assert verdict.reason.code == "motion_stopped"
    assert verdict.state == "held"
    assert not bench.dispatcher.snapshot().latched
    await bench.clock.sleep(0.2)
    assert (await bench.accept("placement.back_off")).state == "standoff"


async def test_configured_offset_is_kept_and_not_counted_as_an_error() -> None:
    async with open_bench({"placement": {"frames": 4, "settle_time": 0.1, "confirm_offset": 0.010}}) as bench:
        placed = await bench.to_placed()
        assert placed.result is not None
        assert placed.result["translation_error"] < 0.0005
        assert await bench.true_height() == pytest.approx(0.010, abs=0.001)
        assert (await bench.accept("placement.back_off")).state == "standoff"
        assert await bench.true_height() == pytest.approx(0.070, abs=0.001)


small = st.tuples(*[st.floats(-0.02, 0.02)] * 3)
places = st.tuples(*[st.floats(-1.0, 1.0)] * 3)


@given(places, places, small, small, st.floats(0.0, 0.05))
def test_errors_are_those_in_the_tool_frame_less_the_offset(
    place: tuple[float, float, float],
    turn: tuple[float, float, float],
    shift: tuple[float, float, float],
    wrong_turn: tuple[float, float, float],
    offset: float,
) -> None:
    """A tool that is off by a known motion in its own frame, wherever it is and however it is turned."""
    expected, error = Transform.from_rotvec(place, turn), Transform.from_rotvec(shift, wrong_turn)
    measured = expected @ error
    # The offset counts along the axis of the measured tool.
    measured = measured @ Transform(np.eye(3), np.array((0.0, 0.0, offset)))
    found = placement_errors(measured, expected, offset)
    assert found["translation_error"] == pytest.approx(np.linalg.norm(shift), abs=1e-9)
    assert found["rotation_error"] == pytest.approx(np.linalg.norm(wrong_turn), abs=1e-7)


@given(places, places)
def test_a_pose_in_a_result_is_the_pose(place: tuple[float, float, float], turn: tuple[float, float, float]) -> None:
    pose = Transform.from_rotvec(place, turn)
    shown = pose_result(pose)
    assert Transform.from_quat_xyzw(shown["position"], shown["quat_xyzw"]).matrix == pytest.approx(pose.matrix)
