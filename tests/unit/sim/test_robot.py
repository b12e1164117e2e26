"""The simulated robot: motions, presses, servo sessions and the limit of the force."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.clock import Clock
from pcmrs.devices.motion._servo import DEADMAN
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.trajectory import joint_motion
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import DeviceEvent, JointSetpoint, JointTrajectory, MotionResult, PressRequest
from pcmrs.spatial import Floats
from pcmrs_sim.opening import open_devices
from pcmrs_sim.settings import GeometrySettings, SimSettings
from tests.unit.sim.cell_readings import Devices
from tests.unit.sim.simulated_arms import FACTS, HOME, body_before_tool, smooth

FLANGE_FROM_TOOL_TIP = GeometrySettings().flange_from_tool_tip.transform


def towards_head(way: float) -> Floats:
    """A posture with the tool `way` (m) farther along its axis, from home."""
    model = ArmModel(FACTS)
    direction = -(model.forward(HOME) @ FLANGE_FROM_TOOL_TIP).rotation[:, 2]
    posture: Floats = HOME + np.linalg.pinv(model.jacobian(HOME)) @ np.concatenate((way * direction, np.zeros(3)))
    return posture


async def pushed_into_head(
    clock: Clock, relief_mm: float, way: float = 0.05
) -> tuple[Any, list[DeviceEvent], float, float]:
    """A motion of `way` against a head 10 mm away: its result, the events, the true force and the tool's way."""
    place = body_before_tool(0.010)
    pose = {"position": place.translation.tolist(), "quat_wxyz": place.quat_wxyz.tolist()}
    settings = {
        "sim": {"geometry": {"world_from_image": pose}},
        "robot": {"force_limit": 10.0, "relief_mm": relief_mm},
    }
    events: list[DeviceEvent] = []
    async with open_devices(("robot", "scene"), settings, clock) as devices:

        async def listen() -> None:
            async for event in devices["robot"].events():
                events.append(event)

        listening = asyncio.create_task(listen())
        await devices["robot"].connect()
        start = await devices["scene"].truth()
        result = await devices["robot"].follow(smooth(HOME, towards_head(way)))
        await clock.sleep(0.1)
        truth = await devices["scene"].truth()
        back = await devices["robot"].follow(smooth(np.array(result.positions), HOME))
        assert back.outcome == "done", "a force that is too great does not keep the arm from going back"
        listening.cancel()
    gone = np.linalg.norm(np.subtract(truth.tracker_from_coil.position, start.tracker_from_coil.position))
    return result, events, truth.contact_force, float(gone)


async def test_too_much_force_stops_the_motion_and_is_reported(clock: Clock) -> None:
    result, (event,), force, gone = await pushed_into_head(clock, relief_mm=0.0)
    assert (result.outcome, result.reason) == ("stopped", "force_limit")
    assert (event.code, event.danger) == ("force_limit", True)
    assert 10.0 < event.fields["force"] < 11.0
    assert event.fields["limit"] == 10.0
    assert event.fields["relieved"] == 0.0
    assert 10.0 < force < 14.0, "it stands where it braked"
    assert gone == pytest.approx(0.010 + force / SimSettings().contact.stiffness, abs=5e-4)


@pytest.mark.parametrize("relief_mm", [1.0, 5.0])
async def test_a_force_is_relieved_by_no_more_than_configured(clock: Clock, relief_mm: float) -> None:
    _, _, force_without, _ = await pushed_into_head(clock, relief_mm=0.0)
    result, (event,), force, _ = await pushed_into_head(clock, relief_mm=relief_mm)
    assert (result.outcome, result.reason) == ("stopped", "force_limit")
    assert event.fields["relieved"] == pytest.approx(relief_mm * 1e-3, abs=1e-4)
    assert event.fields["relieved"] <= relief_mm * 1e-3
    assert force_without - force == pytest.approx(relief_mm, abs=1.0)


async def test_a_touch_below_the_limit_is_nothing_to_report(clock: Clock) -> None:
    result, events, force, _ = await pushed_into_head(clock, relief_mm=5.0, way=0.018)
    assert result.outcome == "done"
    assert 7.0 < force < 9.0
    assert events == []


INWARD = -GeometrySettings().flange_from_tool_tip.transform.rotation[:, 2]
REQUEST = PressRequest(
    force=3.0,
    direction_in_flange=(float(INWARD[0]), float(INWARD[1]), float(INWARD[2])),
    travel=0.010,
    speed=0.02,
    timeout=8.0,
)


async def press_in_cell(clock: Clock, gap: float, **changes: Any) -> MotionResult:
    place = body_before_tool(gap)
    pose = {"position": place.translation.tolist(), "quat_wxyz": place.quat_wxyz.tolist()}
    async with open_devices(("robot",), {"sim": {"geometry": {"world_from_image": pose}}}, clock) as devices:
        await devices["robot"].connect()
        result: MotionResult = await devices["robot"].press(msgspec.structs.replace(REQUEST, **changes))
        state = await devices["robot"].joints()
        assert state.flange_force is not None
        if result.outcome == "done":
            assert -INWARD @ state.flange_force == pytest.approx(result.force, abs=0.2)
    return result


async def test_the_result_has_the_force(clock: Clock) -> None:
    result = await press_in_cell(clock, 0.002)
    assert result.outcome == "done"
    assert result.force == pytest.approx(3.0, abs=0.5)
    result = await press_in_cell(clock, 0.05)
    assert (result.outcome, result.reason) == ("stopped", "no_contact")
    assert result.force == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize(
    "change",
    [
        {"force": 0.5},
        {"force": 5.5},
        {"force": float("nan")},
        {"travel": 0.0},
        {"travel": 0.011},
        {"speed": 0.0},
        {"speed": 0.2},
        {"timeout": -1.0},
        {"timeout": float("inf")},
        {"timeout": float("nan")},
        {"timeout": 20.1},
        {"direction_in_flange": (0.0, 0.0, 0.5)},
    ],
)
async def test_a_press_that_is_not_gentle_is_refused(clock: Clock, change: dict[str, Any]) -> None:
    with pytest.raises(DeviceError, match="must be"):
        await press_in_cell(clock, 0.002, **change)


def at(number: int, positions: Floats, velocities: Floats | None = None, session: int = 1) -> JointSetpoint:
    rates = np.zeros(len(positions)) if velocities is None else velocities
    return JointSetpoint(
        session=session, number=number, sent=0.0, positions=positions.tolist(), velocities=rates.tolist()
    )


@pytest.fixture
async def events(cell: Devices) -> AsyncIterator[list[DeviceEvent]]:
    """What the robot has reported by itself."""

    heard: list[DeviceEvent] = []

    async def listen() -> None:
        async for event in cell["robot"].events():
            heard.append(event)

    listening = asyncio.create_task(listen())
    await asyncio.sleep(0)
    yield heard
    listening.cancel()


async def stream(cell: Devices, clock: Clock, seconds: float, speed: float = 0.1) -> None:
    """Sends set points of the running session that lead all joints away at `speed`, rad/s."""
    robot = cell["robot"]
    start = np.array((await robot.joints()).positions)
    first = robot.sessions.servo.number
    for number in range(1, round(seconds / 0.016) + 1):
        way = speed * number * 0.016
        robot.set_point(at(first + number, start + way, np.full(7, speed), session=robot.sessions.number))
        await clock.sleep(0.016)


async def test_a_session_follows_and_ends_at_rest(cell: Devices, clock: Clock, events: list[DeviceEvent]) -> None:
    robot = cell["robot"]
    await robot.connect()
    async with robot.servo() as stream_of_setpoints:
        for number in range(60):
            velocity = 0.1 if number < 50 else 0.0
            stream_of_setpoints.send(HOME + 0.1 * min(number, 50) * 0.016, [velocity] * 7)
            await clock.sleep(0.016)
        assert (await robot.joints()).moving
    joints = await robot.joints()
    assert np.abs(joints.velocities).max() < 1e-3
    assert np.allclose(joints.positions, HOME + 0.08, atol=2e-4)
    assert events == []
    assert robot.sessions.dropped == 0


@pytest.mark.parametrize("rate", [1.0, 5.0])
async def test_fast_cell_waits_as_long_by_the_clock_of_the_machine(clock: Clock, rate: float) -> None:
    async with open_devices(("robot",), {"cell": {"rate": rate}, "robot": {"deadman": 0.2}}, clock) as devices:
        robot = devices["robot"]
        await robot.connect()
        assert (await robot.begin_servo()).deadman == pytest.approx(0.2 * rate), "s of the cell"


async def test_without_set_points_the_arm_brakes_and_reports_danger(
    cell: Devices, clock: Clock, events: list[DeviceEvent]
) -> None:
    robot = cell["robot"]
    await robot.connect()
    session = await robot.begin_servo()
    assert session.deadman == DEADMAN
    await stream(cell, clock, 0.5)
    await clock.sleep(DEADMAN / 2)
    assert events == []
    await clock.sleep(0.5)
    (event,) = events
    assert (event.code, event.danger, event.fields["reason"]) == ("servo_held", True, "no_set_point")
    joints = await robot.joints()
    assert not joints.moving
    ahead = np.array(joints.positions) - HOME - 0.05
    assert np.all(ahead < 0.1 * (DEADMAN + 0.03)), "it went on for the deadman's time and braked"
    robot.set_point(at(1000, HOME, session=session.session))
    assert robot.sessions.dropped == 1, "the session is over"
    result = await robot.end_servo(session.session)
    assert (result.outcome, result.reason) == ("stopped", "no_set_point")


async def test_session_without_a_set_point_ends_without_motion(
    cell: Devices, clock: Clock, events: list[DeviceEvent]
) -> None:
    robot = cell["robot"]
    await robot.connect()
    await robot.begin_servo()
    await clock.sleep(1.5)
    assert [event.fields["reason"] for event in events] == ["no_set_point"]
    assert np.allclose((await robot.joints()).positions, HOME, atol=1e-4)


async def test_stale_and_foreign_set_points_are_dropped_and_counted(cell: Devices, clock: Clock) -> None:
    robot = cell["robot"]
    await robot.connect()
    robot.set_point(at(1, HOME))
    assert robot.sessions.dropped == 1, "no session"
    first = await robot.begin_servo()
    robot.set_point(at(5, HOME, session=first.session))
    for number, session in ((5, first.session), (4, first.session), (6, first.session + 1), (6, first.session - 1)):
        robot.set_point(at(number, HOME + 0.1, session=session))
    assert robot.sessions.dropped == 5
    await clock.sleep(0.05)
    await robot.end_servo(first.session)
    second = await robot.begin_servo()
    assert second.session > first.session
    robot.set_point(at(100, HOME + 0.1, session=first.session))
    assert robot.sessions.dropped == 6
    assert np.allclose((await robot.hold()).positions, HOME, atol=1e-4)


async def test_hold_ends_a_session(cell: Devices, clock: Clock, events: list[DeviceEvent]) -> None:
    robot = cell["robot"]
    await robot.connect()
    session = (await robot.begin_servo()).session
    await stream(cell, clock, 0.3)
    held = await robot.hold()
    assert np.abs(held.velocities).max() < 1e-3
    robot.set_point(at(1000, HOME, session=session))
    await clock.sleep(0.3)
    assert np.allclose((await robot.joints()).positions, held.positions, atol=1e-4)
    assert events == []
    result = await robot.end_servo(session)
    assert (result.outcome, result.reason) == ("stopped", "held")
    with pytest.raises(DeviceError, match=f"session {session} is over"):
        await robot.end_servo(session)


async def test_late_end_of_a_session_does_not_end_another(cell: Devices, clock: Clock) -> None:
    robot = cell["robot"]
    await robot.connect()
    first = (await robot.begin_servo()).session
    await robot.hold()
    second = (await robot.begin_servo()).session
    with pytest.raises(DeviceError, match=f"session {first} is over"):
        await robot.end_servo(first)
    await stream(cell, clock, 0.1)
    assert robot.sessions.dropped == 0, "the second session goes on"
    assert (await robot.end_servo(second)).outcome == "done"


async def test_session_left_after_a_refused_set_point_raises(
    cell: Devices, clock: Clock, events: list[DeviceEvent]
) -> None:
    robot = cell["robot"]
    await robot.connect()
    with pytest.raises(DeviceError, match="jump"):
        async with robot.servo() as stream_of_setpoints:
            stream_of_setpoints.send(HOME + 0.3, [0.0] * 7)
    await clock.sleep(0.05)
    assert [event.fields["reason"] for event in events] == ["jump"]


@pytest.mark.parametrize("by", ["cut", "disconnect"])
async def test_a_lost_connection_ends_a_session(cell: Devices, clock: Clock, by: str) -> None:
    robot, scene = cell["robot"], cell["scene"]
    await robot.connect()
    await robot.begin_servo()
    await stream(cell, clock, 0.3)
    if by == "cut":
        await scene.cut_robot(True)
        await scene.cut_robot(False)
    else:
        await robot.disconnect()
    await clock.sleep(0.5)
    joints = await robot.connect()
    assert not joints.moving
    assert np.all(np.array(joints.positions) - HOME < 0.05)
    robot.set_point(at(1000, HOME, session=robot.sessions.number))
    assert robot.sessions.dropped == 1


async def test_nothing_else_moves_the_arm_during_a_session(cell: Devices, clock: Clock) -> None:
    robot = cell["robot"]
    await robot.connect()
    session = (await robot.begin_servo()).session
    for call in (lambda: robot.follow(smooth(HOME, HOME + 0.1)), robot.begin_servo):
        with pytest.raises(DeviceError, match="servo session runs"):
            await call()
    await robot.end_servo(session)
    assert (await robot.follow(smooth(HOME, HOME + 0.1))).outcome == "done"


async def test_session_that_ended_by_itself_does_not_bar_a_motion(cell: Devices, clock: Clock) -> None:
    robot = cell["robot"]
    await robot.connect()

    async def jump() -> None:
        async with robot.servo() as stream_of_setpoints:
            stream_of_setpoints.send(HOME + 0.3, [0.0] * 7)
            await clock.sleep(0.3)

    with pytest.raises(DeviceError, match="jump"):
        await jump()
    assert (await robot.follow(smooth(HOME, HOME + 0.1))).outcome == "done"


def motion(start: Floats, goal: Floats) -> JointTrajectory:
    way = (1 - np.cos(np.linspace(0.0, np.pi, 200))) / 2
    return JointTrajectory(period=0.01, positions=(start + way[:, None] * (goal - start)).tolist())


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
    async with aclosing(cell["robot"].states()) as states:
        captured = [(await anext(states)).captured for _ in range(50)]
    assert np.mean(np.diff(captured)) == pytest.approx(0.010, rel=0.05)


every_arm = pytest.mark.parametrize("name", ["panda", "ur5"])


def limits(joints: int) -> MotionLimits:
    return MotionLimits(
        joint_velocity=(0.7,) * joints,
        joint_acceleration=(2.5,) * joints,
        joint_jerk=(15.0,) * joints,
        linear_velocity=0.2,
        linear_acceleration=0.5,
        linear_jerk=3.0,
        angular_velocity=0.6,
        angular_acceleration=1.5,
    )


@every_arm
async def test_arm_stands_at_home_and_follows_to_rest_at_its_goal(name: str, clock: Clock) -> None:
    arm = ArmModel(find_arm(name))
    home = np.array(arm.facts.home)
    async with open_devices(("robot",), {"robot": {"model": name}}, clock) as devices:
        state = await devices["robot"].connect()
        np.testing.assert_allclose(state.positions, home, atol=1e-3)
        assert len(state.velocities) == len(state.torques) == arm.joints
        goal = home + 0.1 * (-1.0) ** np.arange(arm.joints)
        result = await devices["robot"].follow(joint_motion(arm, state.positions, goal, limits(arm.joints)))
        assert result.outcome == "done"
        np.testing.assert_allclose(result.positions, goal, atol=1e-4)
        following = asyncio.create_task(
            devices["robot"].follow(joint_motion(arm, result.positions, home, limits(arm.joints)))
        )
        await clock.sleep(0.3)
        held = await devices["robot"].hold()
        assert (await following).outcome == "stopped"
        assert np.abs(np.subtract(held.positions, home)).max() > 0.01
