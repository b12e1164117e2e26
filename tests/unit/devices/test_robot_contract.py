"""What every robot driver does alike, so that no operation can tell them apart."""

import asyncio
from collections.abc import AsyncIterator

import msgspec
import numpy as np
import pytest
import pytest_asyncio

from pcmrs.errors import DeviceError
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.track import track
from pcmrs.messages import JointSetpoint, JointState, JointTrajectory, PressRequest
from pcmrs.spatial import Floats, Transform, distance
from tests.unit.devices.contract_robots import FACTS, FLANGE_FROM_TOOL, HOME, LOOP_OF_DRIVER, Bench, bench, smooth

pytestmark = [pytest.mark.usefixtures("patient"), pytest.mark.asyncio(loop_scope="module")]
LOOPS = LOOP_OF_DRIVER
MODEL = ArmModel(FACTS)
INWARD = -FLANGE_FROM_TOOL.rotation[:, 2]
PRESS = PressRequest(
    force=3.0,
    direction_in_flange=(float(INWARD[0]), float(INWARD[1]), float(INWARD[2])),
    travel=0.008,
    speed=0.02,
    timeout=8.0,
)
GAP = 0.003
"""From the tool at its home position to the head, m."""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def opened_at_the_head() -> AsyncIterator[Bench]:
    """One cell for all tests of forces: the arm has dynamics, and its sensor has noise."""
    async with bench(GAP, "mujoco") as opened:
        yield opened


@pytest_asyncio.fixture(loop_scope="module")
async def at_the_head(opened_at_the_head: Bench) -> AsyncIterator[Bench]:
    world = opened_at_the_head.cell.world
    await opened_at_the_head.back_home()
    before = world.tracker_from_image.translation
    yield opened_at_the_head
    await opened_at_the_head.back_home()
    world.shift_body(before - world.tracker_from_image.translation)


def towards_the_body(way: float, duration: float) -> JointTrajectory:
    """The tool straight against its +z by a way, m."""
    start = MODEL.forward(HOME)
    goal = start @ FLANGE_FROM_TOOL @ Transform(np.eye(3), np.array([0.0, 0.0, -way])) @ FLANGE_FROM_TOOL.inverse()
    return smooth(HOME, track(MODEL, goal, HOME), duration)


def tool(lab: Bench) -> Transform:
    """Where the tool truly is in the robot's base."""
    return lab.cell.world.arm.base_from_flange() @ FLANGE_FROM_TOOL


def shift_head(lab: Bench, way: float) -> None:
    """Shift the head along the axis of the tool by a way, m; negative is away from it."""
    tracker_from_tool = lab.cell.world.tracker_from("coil")
    assert tracker_from_tool is not None
    lab.cell.world.shift_body(tracker_from_tool.rotation @ np.array((0.0, 0.0, way)))


def set_point(number: int, positions: Floats, session: int, speed: float = 0.0) -> JointSetpoint:
    velocities = [speed] * len(positions)
    return JointSetpoint(session=session, number=number, sent=0.0, positions=positions.tolist(), velocities=velocities)


async def test_nothing_moves_before_it_is_connected() -> None:
    async with bench() as lab:
        for call in (lab.robot.joints, lab.robot.begin_servo, lambda: lab.robot.follow(smooth(HOME, HOME + 0.1))):
            with pytest.raises(DeviceError, match="not connected"):
                await call()
        assert np.allclose((await lab.robot.connect()).positions, HOME, atol=1e-4)
        assert np.allclose((await lab.robot.connect()).positions, HOME, atol=1e-4), "once more does no harm"
        assert lab.robot.trouble == ""


async def test_a_trajectory_is_followed_to_its_end(lab: Bench) -> None:
    goal = HOME + np.array((0.1, -0.05, 0.08, 0.1, -0.1, 0.05, 0.1))
    result = await lab.robot.follow(smooth(HOME, goal))
    assert (result.outcome, result.reason, result.force) == ("done", None, None)
    assert np.abs(np.subtract(result.positions, goal)).max() < 7e-5
    assert np.abs(lab.cell.world.arm.positions - goal).max() < 1e-4, "it truly is there"
    state = await lab.robot.joints()
    assert not state.moving
    assert len(state.positions) == len(state.velocities) == len(state.torques) == len(FACTS.joints)
    assert state.flange_force is not None
    assert np.linalg.norm(state.flange_force) < 1.0
    assert any(each.moving for each in lab.states)
    assert lab.events == []


async def test_a_motion_is_held_anywhere(lab: Bench) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(HOME, HOME + 0.4, 2.0)))
    await lab.moving()
    held = await lab.robot.hold()
    result = await following
    assert (result.outcome, result.reason) == ("stopped", "held")
    assert not held.moving
    assert np.abs(held.velocities).max() < 2e-3
    assert np.all(np.array(held.positions) < HOME + 0.39)
    await lab.clock.sleep(0.2)
    assert np.allclose(lab.cell.world.arm.positions, held.positions, atol=2e-4), "it stays"
    assert (await lab.robot.follow(smooth(np.array(held.positions), HOME))).outcome == "done"


async def test_hold_does_no_harm_to_an_arm_that_stands(lab: Bench) -> None:
    assert np.allclose((await lab.robot.hold()).positions, HOME, atol=1e-4)
    assert (await lab.robot.follow(smooth(HOME, HOME + 0.05))).outcome == "done"


async def test_a_motion_nobody_waits_for_is_braked(lab: Bench) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(HOME, HOME + 0.4, 2.0)))
    await lab.moving()
    following.cancel()
    with pytest.raises(asyncio.CancelledError):
        await following
    held = await lab.robot.hold()
    assert np.all(np.array(held.positions) < HOME + 0.39)
    assert lab.events == []


async def test_one_motion_at_a_time(lab: Bench) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(HOME, HOME + 0.1)))
    await lab.moving()
    for call in (
        lambda: lab.robot.follow(smooth(HOME, HOME)),
        lambda: lab.robot.press(PRESS),
        lab.robot.begin_servo,
    ):
        with pytest.raises(DeviceError, match="still moving"):
            await call()
    assert (await following).outcome == "done"
    session = (await lab.robot.begin_servo()).session
    for call in (lambda: lab.robot.follow(smooth(HOME, HOME)), lab.robot.begin_servo):
        with pytest.raises(DeviceError, match="servo session runs"):
            await call()
    assert (await lab.robot.end_servo(session)).outcome == "done"


async def test_a_trajectory_that_must_not_be_followed_is_refused(lab: Bench) -> None:
    for trajectory, text in (
        (smooth(HOME + 0.1, HOME + 0.2), "present joints"),
        (smooth(HOME, HOME + 3.0, 20.0), "range"),
        (smooth(HOME, HOME + 0.5, 0.1), "slower"),
        (msgspec.structs.replace(smooth(HOME, HOME), period=0.0), "period"),
    ):
        with pytest.raises(DeviceError, match=text):
            await lab.robot.follow(trajectory)
    assert np.allclose((await lab.robot.hold()).positions, HOME, atol=1e-4)


def _rests(joints: JointState, goal: Floats) -> bool:
    there = np.abs(np.subtract(joints.positions, goal)).max() < 5e-4
    return bool(there and np.abs(joints.velocities).max() < 2e-3)


async def test_a_session_follows_and_ends_at_rest(lab: Bench) -> None:
    goal = HOME + 0.1 * 0.016 * 30
    async with lab.robot.servo() as stream:
        for number in range(1, 31):
            speed = 0.1 if number < 30 else 0.0
            stream.send(HOME + 0.1 * 0.016 * number, [speed] * 7)
            await lab.clock.sleep(0.016)
        while not _rests(joints := await lab.robot.joints(), goal):
            stream.send(goal, [0.0] * 7)
            await lab.clock.sleep(0.016)
        assert joints.moving, "until the session is over"
    joints = await lab.robot.joints()
    assert not joints.moving
    assert np.allclose(joints.positions, goal, atol=1e-3)
    assert lab.events == []


async def test_a_session_without_set_points_is_braked_with_an_alarm(lab: Bench) -> None:
    session = (await lab.robot.begin_servo()).session
    lab.robot.set_point(set_point(1, HOME + 0.01, session, 0.1))
    event = await lab.told("servo_held")
    assert (event.danger, event.fields["reason"]) == (True, "no_set_point")
    dropped = lab.robot.sessions.dropped
    lab.robot.set_point(set_point(2, HOME, session))
    assert lab.robot.sessions.dropped == dropped + 1, "the session is over"
    result = await lab.robot.end_servo(session)
    assert (result.outcome, result.reason) == ("stopped", "no_set_point")
    with pytest.raises(DeviceError, match=f"session {session} is over"):
        await lab.robot.end_servo(session)


async def test_a_jump_ends_a_session_before_the_arm_moves(lab: Bench) -> None:
    async def jump() -> None:
        async with lab.robot.servo() as stream:
            stream.send(HOME + 0.3, [0.0] * 7)
            await lab.told("servo_held")

    with pytest.raises(DeviceError, match="jump"):
        await jump()
    assert np.allclose((await lab.robot.joints()).positions, HOME, atol=1e-4)


async def test_a_press_that_is_not_gentle_is_refused(lab: Bench) -> None:
    changes: list[dict[str, float]] = [{"force": 5.5}, {"travel": 0.02}, {"timeout": 21.0}, {"speed": float("nan")}]
    for change in changes:
        with pytest.raises(DeviceError, match=f"{next(iter(change))}.*must be"):
            await lab.robot.press(msgspec.structs.replace(PRESS, **change))
    assert np.allclose((await lab.robot.hold()).positions, HOME, atol=1e-4)


async def test_a_press_in_the_air_ends_at_its_travel(at_the_head: Bench) -> None:
    shift_head(at_the_head, -0.02)
    result = await at_the_head.robot.press(msgspec.structs.replace(PRESS, travel=0.003))
    assert (result.outcome, result.reason) == ("stopped", "no_contact")
    assert result.force == pytest.approx(0.0, abs=0.6)


async def test_a_press_reaches_its_force_and_keeps_it(at_the_head: Bench) -> None:
    contact = at_the_head.cell.world.arm.contact
    result = await at_the_head.robot.press(PRESS)
    assert (result.outcome, result.reason) == ("done", None)
    assert result.force == pytest.approx(3.0, abs=0.6)
    assert contact.force == pytest.approx(3.0, abs=0.6)
    await at_the_head.clock.sleep(0.3)
    assert contact.force == pytest.approx(3.0, abs=0.6)


@pytest.mark.parametrize("motion", ["press", "follow"])
async def test_hold_in_contact_keeps_position_whatever_the_body_does(at_the_head: Bench, motion: str) -> None:
    """No admittance motion and no drift after Stop: neither further in, nor after a body that moves away."""
    robot, cell = at_the_head.robot, at_the_head.cell
    inwards = robot.press(PRESS) if motion == "press" else robot.follow(towards_the_body(GAP + 0.004, 2.0))
    moving = asyncio.create_task(inwards)
    await at_the_head.touching(1.0)
    begun = tool(at_the_head)
    await robot.hold()
    held = tool(at_the_head)
    result = await moving
    assert (result.outcome, result.reason) == ("stopped", "held")
    assert distance(begun, held) < 0.002, "it has braked"
    assert cell.world.arm.contact.force > 0.5
    for along_axis in (0.0, 0.002, -0.01):
        shift_head(at_the_head, along_axis)
        await at_the_head.clock.sleep(1.0)
        assert distance(held, tool(at_the_head)) < 2e-4, f"the body moved by {along_axis} m along the tool's axis"
    assert not (await robot.joints()).moving


async def test_a_disconnected_arm_stands_and_takes_nothing(lab: Bench) -> None:
    following = asyncio.create_task(lab.robot.follow(smooth(HOME, HOME + 0.4, 2.0)))
    await lab.moving()
    await lab.robot.disconnect()
    result = await following
    assert (result.outcome, result.reason) == ("stopped", "held")
    with pytest.raises(DeviceError, match="not connected"):
        await lab.robot.follow(smooth(HOME, HOME))
    state = await lab.robot.connect()
    assert np.allclose(state.positions, result.positions, atol=2e-4)
    assert (await lab.robot.follow(smooth(np.array(state.positions), HOME))).outcome == "done"
