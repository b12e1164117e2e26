"""Set points that an arm must not follow, and limits that hold whatever is sent."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.messages import JointSetpoint
from tests.support.trials import examples
from tests.unit.devices.spring import HOME, MODEL, STEPS, Spring, follower, run


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
