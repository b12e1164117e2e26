import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from pcmrs.clock import Clock
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.protocols import OpenDriver
from pcmrs.errors import ConfigurationError, DeviceError, UnknownOutcomeError
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import BodyPose, JointTrajectory, LandmarkPrompt, PoseMessage
from pcmrs.spatial import Floats, Transform, distance
from pcmrs_sim.cell import BATCH, LONGEST_CATCH_UP, CellSimulation
from pcmrs_sim.error_models import TouchErrors
from pcmrs_sim.opening import open_devices
from pcmrs_sim.phantoms import PHANTOMS
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import DigitizationSettings, SimSettings

Devices = Mapping[str, Any]
HOME = np.array(ARMS["iiwa14"].home)
PROMPT = LandmarkPrompt(index=2, name="left_outer_canthus", position_in_image=(-0.0456, 0.0691, 0.035))


DRIVER: OpenDriver = open_devices  # the type checker proves it


def motion(start: Floats, goal: Floats) -> JointTrajectory:
    way = (1 - np.cos(np.linspace(0.0, np.pi, 200))) / 2
    return JointTrajectory(period=0.01, positions=(start + way[:, None] * (goal - start)).tolist())


def transform(pose: PoseMessage | BodyPose) -> Transform:
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)


async def next_frames(devices: Mapping[str, Any], count: int) -> list[Sequence[BodyPose]]:
    frames = []
    async for frame in devices["tracker"].frames():
        frames.append(frame)
        if len(frames) == count:
            break
    return frames


async def measured_tip(devices: Devices) -> Floats:
    """The touched point in the image as mean over ten frames, with the true registration."""
    tip_in_pointer = SimSettings().geometry.pointer_from_tip.position
    truth = await devices["scene"].truth()
    tips = []
    for _, body_ref, pointer, _ in await next_frames(devices, 10):
        body_ref_from_pointer = transform(body_ref).inverse() @ transform(pointer)
        tips.append(transform(truth.body_ref_from_image).inverse() @ body_ref_from_pointer @ tip_in_pointer)
    return np.asarray(np.mean(tips, axis=0))


async def test_a_motion_ends_done_at_its_goal(cell: Devices) -> None:
    await cell["robot"].connect()
    result = await cell["robot"].follow(motion(HOME, HOME + 0.3))
    assert result.outcome == "done"
    assert np.allclose(result.positions, HOME + 0.3, atol=1e-4)
    assert not (await cell["robot"].joints()).moving


async def test_hold_stops_a_motion_on_its_way(cell: Devices, clock: Clock) -> None:
    robot = cell["robot"]
    await robot.connect()
    following = asyncio.create_task(robot.follow(motion(HOME, HOME + 0.5)))
    await clock.sleep(1.0)
    assert (await robot.joints()).moving
    held = await robot.hold()
    assert (await following).outcome == "stopped"
    assert np.abs(held.velocities).max() < 1e-3
    assert 0.1 < held.positions[0] - HOME[0] < 0.4
    await clock.sleep(1.0)
    assert np.allclose((await robot.joints()).positions, held.positions, atol=1e-4)


async def test_a_second_motion_is_refused_while_one_runs(cell: Devices, clock: Clock) -> None:
    robot = cell["robot"]
    await robot.connect()
    following = asyncio.create_task(robot.follow(motion(HOME, HOME + 0.5)))
    await clock.sleep(0.1)
    with pytest.raises(DeviceError, match="still moving"):
        await robot.follow(motion(HOME, HOME))
    assert (await following).outcome == "done"


async def test_an_abandoned_motion_brakes(cell: Devices, clock: Clock) -> None:
    robot = cell["robot"]
    await robot.connect()
    following = asyncio.create_task(robot.follow(motion(HOME, HOME + 0.5)))
    await clock.sleep(1.0)
    following.cancel()
    await clock.sleep(1.0)
    joints = await robot.joints()
    assert not joints.moving
    assert joints.positions[0] - HOME[0] < 0.4


async def test_a_cut_arm_brakes_and_never_answers(cell: Devices, clock: Clock) -> None:
    robot, scene = cell["robot"], cell["scene"]
    await robot.connect()
    following = asyncio.create_task(robot.follow(motion(HOME, HOME + 0.5)))
    await clock.sleep(1.0)
    await scene.cut_robot(True)
    with pytest.raises(UnknownOutcomeError):
        await following
    for call in (robot.connect, robot.disconnect, robot.joints, robot.hold):
        with pytest.raises(UnknownOutcomeError):
            await call()
    first_state = asyncio.create_task(anext(robot.states()))
    await clock.sleep(1.0)
    assert not first_state.done()
    await scene.cut_robot(False)
    assert not (await first_state).moving
    with pytest.raises(DeviceError, match="connect"):
        await robot.joints()
    assert (await robot.connect()).positions[0] - HOME[0] < 0.4


async def test_disconnected_robot_refuses(cell: Devices) -> None:
    with pytest.raises(DeviceError, match="connect"):
        await cell["robot"].follow(motion(HOME, HOME))


async def test_joint_states_come_at_their_rate(cell: Devices) -> None:
    captured = []
    async for state in cell["robot"].states():
        captured.append(state.captured)
        if len(captured) == 50:
            break
    assert np.mean(np.diff(captured)) == pytest.approx(0.010, rel=0.05)


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


async def test_measured_coil_is_near_the_truth(cell: Devices) -> None:
    truth = transform((await cell["scene"].truth()).tracker_from_coil)
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


async def test_touches_share_a_bias_and_a_displacement_acts_once(cell: Devices) -> None:
    tips = []
    for offset in (0.0, 0.025, 0.0):
        if offset:
            await cell["scene"].displace_touch(PROMPT.index, (offset, 0.0, 0.0))
        await cell["pointer"].touch(PROMPT)
        tips.append(await measured_tip(cell))
    first, displaced, last = tips
    assert np.linalg.norm(first - last) < 0.006
    assert displaced[0] - (first[0] + last[0]) / 2 == pytest.approx(0.025, abs=0.006)
    await cell["pointer"].release()
    assert not (await next_frames(cell, 5))[-1][2].valid


async def test_the_tip_moves_with_the_patient(cell: Devices) -> None:
    await cell["pointer"].touch(PROMPT)
    before = await measured_tip(cell)
    await cell["scene"].move_body((0.02, 0.01, 0.0))
    await next_frames(cell, 5)
    assert np.linalg.norm(await measured_tip(cell) - before) < 5e-4


async def test_hand_released_on_its_way_does_not_continue(cell: Devices) -> None:
    touching = asyncio.create_task(cell["pointer"].touch(PROMPT))
    await next_frames(cell, 1)
    await cell["pointer"].release()
    with pytest.raises(DeviceError, match="released before it reached"):
        await touching
    for _, _, pointer, _ in await next_frames(cell, 5):
        assert not pointer.valid


async def test_a_touch_lands_where_the_seed_says(cell: Devices) -> None:
    for seed in (3, 4):
        await cell["scene"].reseed(seed)
        await cell["pointer"].touch(PROMPT)
        expected = PROMPT.position_in_image + TouchErrors(DigitizationSettings(), seed).next(PROMPT.index)
        assert np.linalg.norm(await measured_tip(cell) - expected) < 5e-4


@pytest.mark.parametrize("name", PHANTOMS)
async def test_the_chosen_phantom_stands_where_it_belongs(name: str, clock: Clock) -> None:
    geometry, phantom = SimSettings().geometry, PHANTOMS[name]
    async with open_devices(("scene",), {"sim": {"phantom": name}}, clock) as devices:
        truth = await devices["scene"].truth()
    tracker_from_image = transform(truth.tracker_from_body_ref) @ transform(truth.body_ref_from_image)
    world_from_image = geometry.world_from_tracker.transform @ tracker_from_image
    assert distance(world_from_image, phantom.world_from_image) < 1e-9
    assert distance(transform(truth.body_ref_from_image), phantom.body_ref_from_image) < 1e-9


async def test_a_configured_place_is_taken_instead(clock: Clock) -> None:
    place = {"position": (0.6, 0.1, 0.2), "quat_wxyz": (0.5, 0.5, 0.5, 0.5)}
    sim = {"phantom": "femur", "geometry": {"world_from_image": place, "body_ref_from_image": place}}
    async with open_devices(("scene",), {"sim": sim}, clock) as devices:
        truth = await devices["scene"].truth()
    world_from_tracker = SimSettings().geometry.world_from_tracker.transform
    assert (world_from_tracker @ transform(truth.tracker_from_body_ref)).matrix == pytest.approx(np.eye(4), abs=1e-6)


async def test_nothing_is_left_behind(clock: Clock) -> None:
    before = asyncio.all_tasks()
    async with open_devices(("robot", "tracker"), {}, clock) as devices:
        await devices["robot"].connect()
        frames = asyncio.create_task(next_frames(devices, 10**6))
        following = asyncio.create_task(devices["robot"].follow(motion(HOME, HOME + 0.3)))
        await clock.sleep(0.2)
    assert len(await frames) > 5
    with pytest.raises(UnknownOutcomeError):
        await following
    assert asyncio.all_tasks() == before


@pytest.mark.parametrize(
    ("devices", "settings", "text"),
    [
        (("robot", "drill"), {}, "drill"),
        (("robot",), {"robot": {"model": "puma560"}}, "puma560"),
        (("robot",), {"robot": {"relief_mm": 6.0}}, "relief_mm"),
        (("robot",), {"sim": {"tracker": {"rate": 60}}}, "rate"),
        (("robot",), {"sim": {"seed": -1}}, "seed"),
        (("robot",), {"sim": {"phantom": "knee"}}, "phantom"),
    ],
)
async def test_bad_configuration_is_refused(
    devices: Sequence[str], settings: dict[str, Any], text: str, clock: Clock
) -> None:
    with pytest.raises(ConfigurationError, match=text):
        async with open_devices(devices, settings, clock):
            pass


async def test_only_the_asked_devices_are_opened(clock: Clock) -> None:
    async with open_devices(("tracker",), {"robot": {"model": "iiwa7"}}, clock) as devices:
        assert set(devices) == {"tracker"}


async def test_a_slow_machine_slows_the_cell_and_is_counted(clock: Clock) -> None:
    cell = CellSimulation(SimSettings(), ARMS["iiwa14"], ForceSettings(), clock)
    frames = asyncio.create_task(next_frames(cell.devices, 5))
    await asyncio.sleep(0)
    now = clock.monotonic()
    cell.advance(now + LONGEST_CATCH_UP + 3.0)
    assert cell.lag == pytest.approx(3.0)
    cell.advance(now + LONGEST_CATCH_UP + 3.05)
    captured = [frame[0].captured for frame in await frames]
    assert min(captured) >= now + 3.0
