"""Set points that an arm must not follow, and limits that hold whatever is sent."""

from collections.abc import Callable
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.motion._servo import LARGEST_JUMP, Servo
from pcmrs.devices.motion.reference import Reference
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.trajectory import brake
from pcmrs.messages import JointSetpoint
from pcmrs.spatial import Floats
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import ArmSettings
from tests.support.trials import examples
from tests.unit.devices.spring import HOME, MODEL, STEPS, Spring, follower, run
from tests.unit.sim.simulated_arms import FACTS


@examples(25)
@given(st.lists(st.tuples(st.floats(-0.19, 0.19), st.floats(-3.0, 3.0), st.integers(1, 20)), min_size=1, max_size=15))
def test_streamed_arm_stays_within_all_limits_whatever_is_sent(course: list[tuple[float, float, int]]) -> None:
    step = 1 / 200
    near_end = HOME.copy()
    near_end[5] = MODEL.upper[5] - 0.15
    arm = follower(step, posture=near_end)
    servo = arm.servo()
    samples = [near_end]
    for number, (jump, speed, steps) in enumerate(course, start=1):
        if arm.reference is servo:
            wanted = np.clip(servo.position + jump, MODEL.lower, MODEL.upper).tolist()
            servo.take(JointSetpoint(session=1, number=number, sent=0.0, positions=wanted, velocities=[speed] * 7))
        samples += [arm.advance()[0].copy() for _ in range(steps)]
    arm.hold()
    while not arm.reference.ended:
        samples.append(arm.advance()[0].copy())
    positions = np.array(samples)
    assert np.all((MODEL.lower <= positions) & (positions <= MODEL.upper))
    assert np.all(np.abs(np.diff(positions, axis=0)) <= MODEL.velocity * step * 1.05)


@STEPS
@pytest.mark.parametrize("end", [-1.0, 1.0])
def test_target_too_fast_for_a_joint_end_is_left_early_enough(step: float, end: float) -> None:
    """The arm can still brake before the end."""
    arm = follower(step)
    servo, joint = arm.servo(), 5
    bound = (MODEL.upper if end > 0.0 else MODEL.lower)[joint]
    numbers = 0
    while arm.reference is servo:
        wanted, velocities = servo.position.copy(), np.zeros(7)
        wanted[joint] = np.clip(wanted[joint] + end * 0.1, MODEL.lower[joint], MODEL.upper[joint])
        velocities[joint] = end * MODEL.velocity[joint]
        numbers += 1
        servo.take(
            JointSetpoint(
                session=1, number=numbers, sent=0.0, positions=wanted.tolist(), velocities=velocities.tolist()
            )
        )
        arm.advance()
        assert numbers < 10.0 / step, "it never ends"
    positions = [arm.reference.position[joint]]
    while not arm.reference.ended:
        positions.append(arm.advance()[0][joint])
    (alarm,) = arm.alarms
    assert (arm.stopped, alarm.fields["reason"], alarm.fields["joint"]) == ("joint_limit", "joint_limit", joint + 1)
    assert (end * (bound - np.array(positions))).min() >= 0.0


@STEPS
def test_first_of_two_unacceptable_set_points_is_reported(step: float) -> None:
    """Both may come before the next sample."""
    arm = follower(step)
    servo = arm.servo()
    far = (HOME + 0.5).tolist()
    for number, (positions, velocities) in enumerate([(far, [0.0] * 7), ([], [])], start=1):
        servo.take(JointSetpoint(session=1, number=number, sent=0.0, positions=positions, velocities=velocities))
    run(arm, Spring(1.0), step, 1.0)
    (alarm,) = arm.alarms
    assert (arm.stopped, alarm.fields["reason"]) == ("jump", "jump")
    assert "0.500 rad from the present posture" in alarm.text
    assert np.array_equal(arm.reference.position, HOME)


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
