"""Frames of the simulated tracker: rate, latency, accuracy and hidden bodies."""

from typing import Any

import numpy as np
import pytest

from pcmrs.clock import Clock
from pcmrs.errors import DeviceError
from pcmrs.spatial import Transform, distance
from pcmrs_sim.cell import BATCH
from pcmrs_sim.markers import MARKER_BODIES
from pcmrs_sim.opening import open_devices
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import GeometrySettings
from tests.unit.sim.cell_readings import Devices, next_frames, transform


async def test_frames_come_at_their_rate_and_latency(cell: Devices) -> None:
    frames = await next_frames(cell, 60)
    captured = np.array([frame[0].captured for frame in frames])
    assert [pose.body for pose in frames[0]] == ["coil", "body_ref", "pointer", "witness"]
    assert np.diff([frame[0].frame_number for frame in frames]).tolist() == [1] * 59
    assert np.mean(np.diff(captured)) == pytest.approx(1 / 60, rel=0.01)
    ages = [pose.sent - pose.captured for frame in frames for pose in frame]
    assert 0.030 - 1e-9 <= min(ages) <= max(ages) < 0.030 + BATCH + STEP


async def test_a_moved_body_is_seen_only_after_the_latency(cell: Devices, clock: Clock) -> None:
    await next_frames(cell, 3)
    moved_at = clock.monotonic()
    before = transform((await cell["scene"].truth()).tracker_from_body_ref).translation
    await cell["scene"].move_body((0.01, 0.0, 0.0))
    frames = await next_frames(cell, 20)
    seen = {body_ref.captured >= moved_at: body_ref.position[0] - before[0] for _, body_ref, _, _ in frames}
    assert seen[False] == pytest.approx(0.0, abs=1e-3)
    assert seen[True] == pytest.approx(0.01, abs=1e-3)


async def test_measured_marker_is_near_the_truth(cell: Devices) -> None:
    """The marker body is what the tracker sees; the truth is told of the contact point."""
    tool_tip_from_tool_marker = GeometrySettings().tool_marker_from_tool_tip.transform.inverse()
    truth = transform((await cell["scene"].truth()).tracker_from_coil) @ tool_tip_from_tool_marker
    for coil, _, _, _ in await next_frames(cell, 20):
        assert distance(transform(coil), truth) < 1e-3


async def test_occluded_bodies_are_invalid_until_shown(cell: Devices) -> None:
    await cell["scene"].occlude("coil", True)
    coil, body_ref, pointer, _ = (await next_frames(cell, 5))[-1]
    assert (coil.valid, coil.reason) == (False, "occluded")
    assert body_ref.valid
    assert (pointer.valid, pointer.reason) == (False, "not_visible")
    await cell["scene"].occlude("coil", False)
    assert (await next_frames(cell, 5))[-1][0].valid
    with pytest.raises(DeviceError, match="nose"):
        await cell["scene"].occlude("nose", True)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"tracker": {"farthest": 0.9}}, "out_of_volume"),
        # Half a turn about its x axis: the spheres look away from the tracker.
        ({"geometry": {"tool_marker_from_tool_tip": {"quat_wxyz": (-0.4, 0.8, 0.4, -0.2)}}}, "occluded"),
    ],
)
async def test_a_tool_that_cannot_be_seen_is_lost(settings: dict[str, Any], reason: str, clock: Clock) -> None:
    async with open_devices(("tracker",), {"sim": settings}, clock) as devices:
        coil, _, _, _ = (await next_frames(devices, 3))[-1]
    assert (coil.valid, coil.reason) == (False, reason)


async def test_of_three_spheres_the_pose_is_still_measured(clock: Clock) -> None:
    """A hand before one sphere of the reference: the fit gets worse, and the pose stays right."""
    async with open_devices(("tracker", "scene"), {"sim": {"tracker": {"jitter_mm": 0.0}}}, clock) as devices:
        before, during = (await next_frames(devices, 2))[-1][1], None
        world = devices["scene"]._world
        sight = world.tracker_from_image.inverse().translation
        reference = world.body_ref_from_image.inverse()
        for sphere in reference @ MARKER_BODIES["body_ref"].positions:
            world.image_from_pointer = Transform(
                np.eye(3), sphere + 0.15 * (sight - sphere) / np.linalg.norm(sight - sphere)
            )
            if world.observe().sight("body_ref").seen.sum() == 3:
                during = (await next_frames(devices, 4))[-1][1]
                assert during.valid
                assert distance(transform(during), transform(before)) < 1e-9
    assert during is not None, "one of the places hides a single sphere"
