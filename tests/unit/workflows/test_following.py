"""The tool keeps its place on a head that moves, says when it does not, and never goes anywhere by itself."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.errors import RefusalError
from pcmrs.messages import DeviceEvent, HeadBurst, HeadMotion, HeadStep
from pcmrs.spatial import Floats, Transform, distance
from pcmrs.workflows._alignment import BODIES
from pcmrs.workflows._following import BodyFollower
from pcmrs.workflows.data import as_transform
from pcmrs_sim.settings import GeometrySettings
from tests.unit.workflows.workflow_bench import DYNAMICS, WorkflowBench, open_bench

Z = (0.0, 0.0, 1.0)
BREATHING = HeadMotion(breathing_amplitude=0.002, breathing_hz=0.25, breathing_direction=Z)


@pytest.fixture
async def following() -> AsyncIterator[WorkflowBench]:
    """A tool that follows the head, and counts as aligned."""
    async with open_bench() as bench:
        await follow(bench)
        yield bench


async def follow(bench: WorkflowBench) -> None:
    await bench.to_placed()
    assert (await bench.accept("placement.follow")).state == "following"
    await bench.until(lambda: aligned(bench))


def aligned(bench: WorkflowBench) -> bool:
    return bench.states["alignment"] == "1"


async def true_error(bench: WorkflowBench) -> float:
    """Distance of the tool from where it truly should be on the body, as registered, m."""
    truth = await bench.scene.truth()
    assert bench.data.registered is not None
    assert bench.data.plan is not None
    body_ref_from_tool_tip = as_transform(bench.data.registered.body_ref_from_image) @ as_transform(bench.data.plan)
    desired = as_transform(truth.tracker_from_body_ref) @ body_ref_from_tool_tip
    return distance(desired, as_transform(truth.tracker_from_coil))


async def errors(bench: WorkflowBench, seconds: float) -> Floats:
    """True errors as time goes on, m, (N,)."""
    end, found = bench.clock.monotonic() + seconds, []
    while bench.clock.monotonic() < end:
        await bench.clock.sleep(0.02)
        found.append(await true_error(bench))
    return np.array(found)


async def tool(bench: WorkflowBench) -> Transform:
    """``tracker_from_coil`` as it truly is."""
    return as_transform((await bench.scene.truth()).tracker_from_coil)


def danger(bench: WorkflowBench) -> str:
    """Text of the last end of an activity."""
    return [e.text for e in bench.published if isinstance(e, DeviceEvent) and e.code == "activity_ended"][-1]


async def ended(bench: WorkflowBench) -> None:
    """Waits until the tool does not follow any more, and checks how that ended: held, latched, at rest."""
    await bench.until(lambda: bench.states["placement"] != "following")
    assert bench.states["placement"] == "held"
    assert bench.states["alignment"] == "0"
    assert bench.dispatcher.snapshot().latched
    await bench.until(lambda: bench.speed() < 1e-3)
    where = await tool(bench)
    await bench.clock.sleep(2.0)
    assert distance(where, await tool(bench)) < 1e-4
    assert bench.states["placement"] == "held"


@pytest.mark.nightly
async def test_tool_follows_breathing_to_a_fraction_of_its_amplitude() -> None:
    async with open_bench(sim=DYNAMICS) as bench:
        await follow(bench)
        await bench.scene.set_motion(BREATHING)
        found = await errors(bench, 8.0)
        assert np.sqrt(np.mean(found**2)) < 0.0003
        assert found.max() < 0.0008
        assert aligned(bench)


@pytest.mark.nightly
async def test_a_tool_that_stands_meets_no_such_bounds() -> None:
    async with open_bench() as bench:
        await bench.to_placed()
        await bench.scene.set_motion(BREATHING)
        found = await errors(bench, 8.0)
    assert np.sqrt(np.mean(found**2)) > 0.001
    assert found.max() > 0.002


async def test_drift_is_followed_far_beyond_what_is_corrected_at_once(following: WorkflowBench) -> None:
    await following.scene.set_motion(HeadMotion(drift=(0.004, 0.0, 0.0)))
    found = await errors(following, 5.0)
    assert found.max() < 0.0012, found.max()
    assert aligned(following)


async def test_after_a_step_the_tool_is_back_and_alignment_too() -> None:
    async with open_bench(sim=DYNAMICS) as bench:
        await follow(bench)
        await bench.scene.set_motion(HeadMotion(steps=[HeadStep(time=0.1, offset=(0.005, 0.0, 0.0))]))
        found = await errors(bench, 2.0)
        assert found.max() > 0.002
        assert found[-20:].max() < 0.0005
        await bench.until(lambda: aligned(bench))


async def test_head_quicker_than_the_tool_closes_the_gate_meanwhile() -> None:
    burst = HeadMotion(bursts=[HeadBurst(time=0.1, duration=0.8, speed=0.086, direction=(1.0, 0.0, 0.0))])
    async with open_bench({"following": {"linear_velocity": 0.05}}) as bench:
        await follow(bench)
        await bench.scene.set_motion(burst)
        await bench.until(lambda: not aligned(bench))
        # Within the latency of the tracker and the 0.1 s for which an error must last.
        assert await true_error(bench) < 0.02
        assert (await errors(bench, 0.5)).max() > 0.015
        assert bench.states["placement"] == "following"
        await bench.until(lambda: aligned(bench))
        assert await true_error(bench) < 0.001


async def test_a_tracker_that_was_restarted_is_not_followed(following: WorkflowBench) -> None:
    following.tracker_session = "second"
    await ended(following)
    assert "The tracker was restarted" in danger(following)


async def test_tool_in_place_is_aligned_again_after_a_tracker_restart(bench: WorkflowBench) -> None:
    await bench.to_placed()
    await bench.until(lambda: aligned(bench))
    await bench.scene.occlude("coil", hidden=True)
    await bench.until(lambda: not aligned(bench))
    bench.tracker_session, bench.tracker._frame_number = "second", 0  # type: ignore[attr-defined]
    await bench.scene.occlude("coil", hidden=False)
    await bench.until(lambda: aligned(bench))


@pytest.mark.parametrize("compensated", [True, False])
@pytest.mark.nightly
async def test_latency_is_compensated(compensated: bool) -> None:
    """What is 60 ms behind a head at 10 mm/s is 0.6 mm behind; the integral has been given no time."""
    slow = {"compensated": compensated, "correction_time": 1e3}
    async with open_bench({"following": slow}, DYNAMICS) as bench:
        await follow(bench)
        await bench.scene.set_motion(HeadMotion(drift=(0.010, 0.0, 0.0)))
        mean = (await errors(bench, 3.0))[50:].mean()
    assert mean < 0.0003 if compensated else mean > 0.0004


async def test_stop_ends_it(following: WorkflowBench) -> None:
    await following.scene.set_motion(BREATHING)
    await following.clock.sleep(1.0)
    await following.dispatcher.stop("test:operator")
    await ended(following)
    await following.accept("robot.acknowledge")
    await following.clock.sleep(1.0)
    assert following.states["placement"] == "held", "nothing goes on by itself"
    assert (await following.accept("placement.back_off")).state in ("standoff", "retracted")


@pytest.mark.parametrize("body", ["coil", "body_ref"])
async def test_unseen_body_is_not_followed(following: WorkflowBench, body: str) -> None:
    await following.scene.set_motion(BREATHING)
    await following.scene.occlude(body, True)
    where = await tool(following)
    await ended(following)
    assert "not been seen" in danger(following)
    assert distance(where, await tool(following)) < 0.001
    await following.scene.occlude(body, False)
    await following.clock.sleep(1.0)
    assert following.states["placement"] == "held"


async def test_frames_that_are_lost_for_a_moment_are_bridged(following: WorkflowBench) -> None:
    await following.scene.set_motion(BREATHING)
    for _ in range(5):
        await following.scene.occlude("body_ref", True)
        await following.clock.sleep(0.05)
        await following.scene.occlude("body_ref", False)
        await following.clock.sleep(0.3)
    assert following.states["placement"] == "following"
    assert await true_error(following) < 0.001


async def test_a_reference_that_jumps_is_not_followed(following: WorkflowBench) -> None:
    where = await tool(following)
    await following.scene.bump_reference((0.015, 0.0, 0.0), (0.0, 0.0, 0.0))
    await ended(following)
    assert distance(where, await tool(following)) < 0.003


async def test_a_head_that_goes_too_far_is_not_followed() -> None:
    async with open_bench({"following": {"range": 0.01}}) as bench:
        await follow(bench)
        await bench.scene.set_motion(HeadMotion(drift=(0.010, 0.0, 0.0)))
        await ended(bench)
        assert "limit is 10 mm" in danger(bench)


async def test_an_arm_that_would_come_into_a_zone_by_following_is_held() -> None:
    box = {"name": "monitor", "pose": {"position": (0.587, 0.0, 0.15)}, "size": (0.1, 0.1, 0.1)}
    async with open_bench({"zones": {"boxes": [box]}}) as bench:
        await follow(bench)
        where = await tool(bench)
        tracker_from_base = GeometrySettings().world_from_tracker.transform.inverse()
        x, y, z = tracker_from_base.rotation @ np.array((0.012, 0.0, 0.0))
        await bench.scene.set_motion(HeadMotion(drift=(x, y, z)))
        await ended(bench)
        assert "mm of monitor" in danger(bench)
        # 35 mm were between tool and box at first, and 15 mm stay.
        assert distance(where, await tool(bench)) == pytest.approx(0.020, abs=0.003)


async def test_a_registration_given_up_ends_it(following: WorkflowBench) -> None:
    await following.accept("registration.clear_registration")
    assert following.states["placement"] == "held"
    await following.until(lambda: following.speed() < 1e-3)
    assert not following.dispatcher.snapshot().latched


@pytest.mark.parametrize(("name", "states"), [("back_off", ("standoff", "retracted")), ("home", ("retracted",))])
async def test_the_tool_retreats_from_a_head_that_moves(
    following: WorkflowBench, name: str, states: tuple[str, ...]
) -> None:
    await following.scene.set_motion(BREATHING)
    await following.clock.sleep(1.3)
    verdict = await following.accept(f"placement.{name}")
    assert verdict.state in states
    assert await following.true_height() > 0.06
    assert not following.dispatcher.snapshot().latched


async def test_following_ends_where_the_tool_is_and_can_be_resumed(following: WorkflowBench) -> None:
    assert (await following.accept("placement.stop_following")).state == "placed"
    assert not aligned(following)
    await following.until(lambda: aligned(following))
    await following.accept("placement.follow")
    assert not aligned(following), "alignment is watched anew"
    await following.until(lambda: aligned(following))


async def test_tool_far_from_its_place_does_not_go_there_by_following() -> None:
    async with open_bench() as bench:
        await bench.to_placed()
        await bench.scene.move_body((0.010, 0.0, 0.0))
        await bench.clock.sleep(1.0)
        verdict = await bench.refuse("placement.follow", "correction_too_large")
        assert verdict.reason is not None
        assert verdict.reason.fields["shift_mm"] == pytest.approx(10.0, abs=0.5)


async def test_a_hidden_tool_is_not_aligned_at_its_place() -> None:
    async with open_bench() as bench:
        await bench.to_placed()
        await bench.until(lambda: aligned(bench))
        await bench.scene.occlude("coil", True)
        await bench.until(lambda: not aligned(bench))
        assert bench.states["placement"] == "placed"
        assert not bench.dispatcher.snapshot().latched
        await bench.scene.occlude("coil", False)
        await bench.until(lambda: aligned(bench))


async def test_the_snapshot_shows_the_error(following: WorkflowBench) -> None:
    (activity,) = following.dispatcher.snapshot().activities
    values: dict[str, Any] = activity.values
    assert activity.name == "follow_head"
    assert 0.0 <= values["error_mm"] < 1.0
    assert 0.0 <= values["error_deg"] < 1.0
    before = len(following.published)
    await following.clock.sleep(5.0)
    assert len(following.published) - before <= 15, "a few snapshots per second"


async def test_late_acknowledgement_does_not_hold_a_following_tool(
    following: WorkflowBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody else has acknowledged, the tool follows the head again, and nothing is latched any more."""
    held: list[float] = []
    hold = following.robot.hold

    async def counted() -> object:
        held.append(following.clock.monotonic())
        return await hold()

    monkeypatch.setattr(following.robot, "hold", counted)
    await following.cell.release(stopped=False)
    await following.clock.sleep(1.0)
    assert held == []
    assert following.states["placement"] == "following"


@pytest.mark.parametrize("missing", ["registered", "plan"])
async def test_nothing_is_followed_without_a_registration_and_a_plan(bench: WorkflowBench, missing: str) -> None:
    await bench.to_placed()
    frames = bench.cell.poses.frames_after(0, BODIES)[-10:]
    assert BodyFollower(bench.cell, bench.data, frames).moved == 0.0
    with pytest.raises(RefusalError, match="cannot follow the body") as refused:
        BodyFollower(bench.cell, msgspec.structs.replace(bench.data, **{missing: None}), frames)
    assert refused.value.refusal_code == "not_registered"
