"""Orders to the scene: a head that moves, a reference that is bumped, and a pointer that pivots."""

import numpy as np
import pytest

from pcmrs.clock import Clock
from pcmrs.errors import DeviceError
from pcmrs.messages import BodyPose, HeadBurst, HeadMotion
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs_sim.head import CENTRE
from pcmrs_sim.motion import head_offset
from pcmrs_sim.opening import open_devices
from pcmrs_sim.settings import SimSettings
from tests.unit.sim.cell_readings import Devices, next_frames, transform

X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
ERRORLESS = {"jitter_mm": 0.0, "bias_mm": 0.0, "bias_deg": 0.0}


async def frames(cell: Devices, count: int) -> list[dict[str, BodyPose]]:
    return [{pose.body: pose for pose in frame} for frame in await next_frames(cell, count)]


async def test_the_body_moves_with_its_reference_in_cell_time(clock: Clock) -> None:
    async with open_devices(("tracker", "scene"), {"sim": {"tracker": ERRORLESS}}, clock) as cell:
        scene = cell["scene"]
        start = await scene.truth()
        motion = HeadMotion(bursts=[HeadBurst(time=0.0, duration=0.5, speed=0.086, direction=X)])
        await scene.set_motion(motion)
        begun = (await scene.truth()).time
        for frame in await frames(cell, 50):
            for body in ("body_ref", "witness"):
                moved = np.array(frame[body].position)
                if body == "body_ref":
                    moved -= start.tracker_from_body_ref.position
                    assert moved == pytest.approx(head_offset(motion, frame[body].captured - begun), abs=1.1e-3 * 0.086)
        end = await scene.truth()
        assert distance(transform(end.tracker_from_body_ref), transform(start.tracker_from_body_ref)) == pytest.approx(
            0.043
        )
        assert end.body_ref_from_image == start.body_ref_from_image
        await scene.set_motion(HeadMotion())
        await scene.move_body((0.01, 0.0, 0.0))
        shifted = await scene.truth()
        assert shifted.tracker_from_body_ref.position[0] - end.tracker_from_body_ref.position[0] == pytest.approx(0.01)


async def test_a_direction_that_is_no_unit_vector_is_refused(cell: Devices) -> None:
    burst = HeadBurst(time=0.0, duration=1.0, speed=0.086, direction=(1.0, 1.0, 0.0))
    for motion in (HeadMotion(bursts=[burst]), HeadMotion(breathing_direction=(0.0, 0.0, 0.0))):
        with pytest.raises(DeviceError, match="unit vector"):
            await cell["scene"].set_motion(motion)


async def test_a_bumped_reference_moves_against_body_and_witness(clock: Clock) -> None:
    async with open_devices(("tracker", "scene"), {"sim": {"tracker": ERRORLESS}}, clock) as cell:
        scene = cell["scene"]
        before, (frame_before,) = await scene.truth(), await frames(cell, 1)
        bump = Transform.from_rotvec((0.005, 0.0, 0.002), (0.0, 0.05, 0.0))
        await scene.bump_reference((0.005, 0.0, 0.002), (0.0, 0.05, 0.0))
        after, frame_after = await scene.truth(), (await frames(cell, 5))[-1]
    old, new = transform(before.tracker_from_body_ref), transform(after.tracker_from_body_ref)
    assert (old.inverse() @ new).matrix == pytest.approx(bump.matrix, abs=1e-12)
    body = [transform(t.tracker_from_body_ref) @ transform(t.body_ref_from_image) for t in (before, after)]
    assert body[1].matrix == pytest.approx(body[0].matrix, abs=1e-12), "the body has not moved"
    witness = [transform(frame["witness"]) for frame in (frame_before, frame_after)]
    assert distance(*witness) < 1e-9
    seen = [transform(frame["body_ref"]) for frame in (frame_before, frame_after)]
    assert distance(*seen) == pytest.approx(np.hypot(0.005, 0.002), abs=1e-9)
    assert rotation_angle(*seen) == pytest.approx(0.05, abs=1e-6)


async def test_pivoting_pointer_turns_about_a_fixed_tip_and_goes_away(clock: Clock) -> None:
    async with open_devices(("tracker", "pointer", "scene"), {"sim": {"tracker": ERRORLESS}}, clock) as cell:
        scene = cell["scene"]
        assert (await scene.truth()).tip_in_tracker is None
        await scene.pivot_pointer(20.0)
        truth = await scene.truth()
        poses = [transform(frame["pointer"]) for frame in await frames(cell, 1150)]
        tips = np.array([pose @ truth.tip_in_pointer for pose in poses])
        assert truth.tip_in_pointer == SimSettings().geometry.pointer_from_tip.position
        assert np.abs(tips - truth.tip_in_tracker).max() < 1e-9
        shafts = np.array([pose.rotation[:, 2] for pose in poses])
        assert np.degrees(np.arccos((shafts @ shafts.T).min())) > 60.0
        rows = np.vstack([np.hstack((pose.rotation, -np.eye(3))) for pose in poses])
        solved = np.linalg.lstsq(rows, -np.concatenate([pose.translation for pose in poses]), rcond=None)[0]
        assert solved[:3] == pytest.approx(truth.tip_in_pointer, abs=1e-9)
        assert np.linalg.cond(rows) < 10.0, "the tip is well determined"
        assert not (await frames(cell, 100))[-1]["pointer"].valid
        await scene.pivot_pointer(20.0)
        await cell["pointer"].release()
        assert (await scene.truth()).tip_in_tracker is None


async def test_the_body_is_near_if_it_is_in_front_of_the_tool(cell: Devices) -> None:
    scene = cell["scene"]
    assert not scene.is_near_body(0.05)
    truth = await scene.truth()
    body = transform(truth.tracker_from_body_ref) @ transform(truth.body_ref_from_image)
    towards = scene.tool.translation - 0.15 * scene.tool.rotation[:, 2]
    await scene.move_body(tuple((towards - body @ CENTRE).tolist()))
    assert scene.is_near_body(0.08)
    assert not scene.is_near_body(0.03)
