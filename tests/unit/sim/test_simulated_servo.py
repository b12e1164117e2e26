"""A stream of set points: followed closely within all limits, and braked whenever it must be."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import Clock
from pcmrs.devices.motion.reference import Reference
from pcmrs.devices.motion.servo import DEADMAN, LARGEST_JUMP, Servo
from pcmrs.errors import DeviceError
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.trajectory import brake
from pcmrs.messages import DeviceEvent, JointSetpoint
from pcmrs.spatial import Floats
from pcmrs_sim.opening import open_devices
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import ArmSettings
from tests.support.trials import examples
from tests.unit.sim.simulated_arms import FACTS, HOME, smooth

Devices = Mapping[str, Any]
MODEL = ArmModel(FACTS)
ACCELERATION, JERK = ArmSettings().brake_acceleration, ArmSettings().brake_jerk
LIMITS = MotionLimits(tuple(MODEL.velocity), (ACCELERATION,) * 7, (JERK,) * 7, 1.0, 1.0, 1.0, 1.0, 1.0)
TRACKER_STEPS = 17  # between set points at the tracker's rate


def at(number: int, positions: Floats, velocities: Floats | None = None, session: int = 1) -> JointSetpoint:
    rates = np.zeros(len(positions)) if velocities is None else velocities
    return JointSetpoint(
        session=session, number=number, sent=0.0, positions=positions.tolist(), velocities=rates.tolist()
    )


def lag(amplitude: float, hz: float) -> tuple[float, float]:
    """Root mean square and greatest distance from a sine in all joints, rad, after the first second."""
    servo = Servo(HOME, FACTS, LIMITS, STEP)
    errors = []
    for step in range(5000):
        angle = 2 * pi * hz * step * 1e-3
        if step % TRACKER_STEPS == 0:
            velocity = np.full(7, 2 * pi * hz * amplitude * cos(angle))
            servo.take(at(step + 1, HOME + amplitude * sin(angle), velocity))
        servo.advance()
        errors.append(servo.position[0] - HOME[0] - amplitude * sin(angle + 2 * pi * hz * 1e-3))
    assert servo.halt is None
    return float(np.sqrt(np.mean(np.square(errors[1000:])))), float(np.abs(errors[1000:]).max())


@pytest.mark.parametrize(("amplitude", "hz", "limit"), [(0.004, 0.25, 2e-6), (0.05, 0.5, 2e-4), (0.05, 0.1, 5e-6)])
def test_a_moving_target_is_followed_without_lag(amplitude: float, hz: float, limit: float) -> None:
    rms, greatest = lag(amplitude, hz)
    assert rms < limit
    assert greatest < 3 * limit


@examples(25)
@given(st.lists(st.tuples(st.floats(-0.19, 0.19), st.floats(-3.0, 3.0), st.integers(1, 60)), min_size=1, max_size=15))
def test_whatever_is_sent_stays_within_all_limits(course: list[tuple[float, float, int]]) -> None:
    near_end = HOME.copy()
    near_end[5] = MODEL.upper[5] - 0.15
    servo = Servo(near_end, FACTS, LIMITS, STEP)
    samples = [np.stack((near_end, np.zeros(7), np.zeros(7)))]
    for number, (jump, speed, steps) in enumerate(course, start=1):
        wanted = np.clip(servo.position + jump, MODEL.lower, MODEL.upper)
        servo.take(at(number, wanted, np.full(7, speed)))
        while steps and servo.halt is None:
            samples.append(servo.advance().copy())
            steps -= 1
        if servo.halt is not None:
            break  # the arm brakes at once
    stop = Reference.along(brake(servo.position.tolist(), servo.velocity.tolist(), LIMITS), servo, STEP)
    while not stop.ended:
        samples.append(stop.advance())
    positions, velocities, accelerations = np.array(samples).swapaxes(0, 1)
    assert np.all((MODEL.lower <= positions) & (positions <= MODEL.upper))
    assert np.all(np.abs(velocities) <= MODEL.velocity * 1.001)
    assert np.all(np.abs(accelerations) <= ACCELERATION * 1.05)
    assert np.abs(np.diff(positions, axis=0)).max() <= MODEL.velocity.max() * 1.001e-3


def beyond_range() -> Floats:
    posture = HOME.copy()
    posture[6] = MODEL.lower[6] - 0.01
    return posture


REFUSED: dict[str, Callable[[], JointSetpoint]] = {
    "jump": lambda: at(1, HOME + LARGEST_JUMP + 0.01),
    "out_of_range": lambda: at(1, beyond_range()),
    "malformed": lambda: at(1, HOME[:6]),
}


@pytest.mark.parametrize("reason", [*REFUSED, "not finite"])
def test_a_set_point_that_must_not_be_followed_halts(reason: str) -> None:
    servo = Servo(HOME, FACTS, LIMITS, STEP)
    servo.take(REFUSED.get(reason, lambda: at(1, np.full(7, np.nan)))())
    assert servo.halt == (reason if reason in REFUSED else "malformed")
    assert servo.alarm is not None
    assert servo.alarm.code == "servo_held"
    assert np.array_equal(servo.advance()[0], HOME), "it was not followed"


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
