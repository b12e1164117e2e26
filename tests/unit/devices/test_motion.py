"""References at the rate of a streamed arm: the same limits hold as at that of a control loop."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.motion.follower import Follower, brake_limits
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.motion.press import RESISTANCE
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointSetpoint, JointTrajectory, PressRequest
from pcmrs.spatial import Floats
from tests.support.trials import examples

MODEL = ArmModel(ARMS["iiwa14"])
HOME = np.array(ARMS["iiwa14"].home)
ACCELERATION, JERK = 10.0, 200.0
LIMITS = brake_limits(MODEL.facts, ACCELERATION, JERK)
STEPS = pytest.mark.parametrize("step", [1 / 1000, 1 / 200])


class Spring:
    """The tool at a spring that begins `gap` m before it, seen without delay."""

    axis = np.array((0.0, 0.0, -1.0))

    def __init__(self, gap: float, stiffness: float = 1000.0) -> None:
        self._gap, self._stiffness = gap, stiffness
        self.magnitude = 0.0
        self._start = MODEL.forward(HOME)

    def move_to(self, gap: float, posture: Floats) -> None:
        """The body has moved: it begins `gap` m before where the tool was at first; the tool is at `posture`."""
        self._gap = gap
        self.look(posture)

    def look(self, posture: Floats) -> None:
        way = self._start.inverse() @ MODEL.forward(posture).translation
        self.magnitude = max(0.0, float(way[2]) - self._gap) * self._stiffness

    @property
    def flange_force(self) -> tuple[float, float, float]:
        return (0.0, 0.0, -self.magnitude)


def follower(step: float, sensor: Spring | None = None, posture: Floats = HOME, **force: float) -> Follower:
    return Follower(MODEL, LIMITS, ForceSettings(**force), sensor or Spring(1.0), posture, step)


def run(arm: Follower, sensor: Spring, step: float, seconds: float) -> Floats:
    """Samples until the arm stands, (N, 3, n)."""
    samples = []
    for _ in range(round(seconds / step)):
        samples.append(arm.advance().copy())
        sensor.look(samples[-1][0])
        if arm.reference.ended:
            break
    return np.array(samples)


@STEPS
def test_a_trajectory_ends_where_and_when_it_should(step: float) -> None:
    time = np.linspace(0.0, 1.0, 101)
    way = (10 * time**3 - 15 * time**4 + 6 * time**5)[:, None] * 0.3
    arm = follower(step)
    arm.follow(JointTrajectory(period=0.01, positions=(HOME + way * np.ones(7)).tolist()))
    samples = run(arm, Spring(1.0), step, 5.0)
    assert len(samples) == round(1.0 / step)
    assert np.allclose(samples[-1, 0], HOME + 0.3)
    assert np.allclose(samples[-1, 1:], 0.0)
    assert np.allclose(np.diff(samples[:, 0], axis=0) / step, samples[1:, 1], atol=3.0 * step)


@STEPS
@pytest.mark.parametrize("again", [False, True])
def test_a_held_motion_brakes_as_fast_as_the_limits_allow(step: float, again: bool) -> None:
    arm = follower(step)
    arm.follow(JointTrajectory(period=1.0, positions=[HOME.tolist(), (HOME + 0.3).tolist(), (HOME + 0.6).tolist()]))
    speed = float([arm.advance() for _ in range(round(1.0 / step))][-1][1].max())
    samples = np.array([arm.reference.advance()])
    arm.hold()
    while not arm.reference.ended:
        samples = np.concatenate((samples, arm.advance()[None]))
        if again:
            arm.hold()
    assert arm.stopped == "held"
    assert np.all(samples[1:, 1] <= samples[:-1, 1] + 1e-9), "never faster"
    assert len(samples) * step == pytest.approx(speed / ACCELERATION + ACCELERATION / JERK, abs=2.1 * 0.005)


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
def test_a_press_reaches_its_force(step: float) -> None:
    sensor = Spring(gap=0.002)
    arm = follower(step, sensor)
    press = arm.press(
        PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.010, speed=0.02, timeout=8.0)
    )
    samples = run(arm, sensor, step, 10.0)
    assert arm.stopped is None
    assert press.force == pytest.approx(3.0, abs=0.3)
    speeds = np.array([np.linalg.norm(MODEL.jacobian(q)[:3] @ v) for q, v, _ in samples])
    assert speeds.max() <= 3.0 / RESISTANCE * 1.05


@STEPS
@pytest.mark.parametrize("relief_mm", [0.0, 2.0])
def test_held_arm_in_contact_moves_only_to_relieve_excess_force(step: float, relief_mm: float) -> None:
    sensor = Spring(gap=0.002)
    arm = follower(step, sensor, force_limit=10.0, relief_mm=relief_mm)
    arm.press(PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.010, speed=0.02, timeout=8.0))
    while sensor.magnitude < 2.0:
        sensor.look(arm.advance()[0])
    arm.hold()
    run(arm, sensor, step, 1.0)
    held = arm.reference.position.copy()
    assert arm.reference.ended
    for _ in range(3):  # nothing draws it after a force that is less, or greater, than it was
        for gap in (0.010, 0.002, -0.003):
            sensor.move_to(gap, held)
            assert np.array_equal(arm.advance()[0], held)
    for gap in (-0.012, -0.022, -0.032):  # the body comes nearer and nearer
        for _ in range(round(1.0 / step)):
            sensor.move_to(gap, arm.advance()[0])
            arm.hold()  # Stop, pressed again and again
    way = MODEL.forward(held).inverse() @ MODEL.forward(arm.reference.position).translation
    assert -relief_mm * 1e-3 - 1e-4 <= way[2] <= 0.0
    assert np.linalg.norm(way[:2]) < 1e-4


@STEPS
def test_excessive_force_is_relieved_and_reported(step: float) -> None:
    sensor = Spring(gap=-0.03)  # 30 N at once
    sensor.look(HOME)
    arm = follower(step, sensor, force_limit=20.0, relief_mm=2.0)
    samples = run(arm, sensor, step, 5.0)
    (alarm,) = arm.alarms
    assert (alarm.code, alarm.danger) == ("force_limit", True)
    way = MODEL.forward(HOME).inverse() @ MODEL.forward(samples[-1, 0]).translation
    assert np.allclose(way, (0.0, 0.0, -0.002), atol=1e-4)


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


@STEPS
def test_a_press_that_leads_out_of_a_joints_range_is_held(step: float) -> None:
    free, sensor = follower(step), Spring(1.0)
    request = PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.010, speed=0.02, timeout=8.0)
    free.press(request)
    way = run(free, sensor, step, 10.0)[-1, 0] - HOME
    joint = int(np.abs(way).argmax())
    half = float(HOME[joint] + way[joint] / 2)
    joints = list(MODEL.facts.joints)
    rising, facts = bool(way[joint] > 0.0), joints[joint]
    joints[joint] = dataclasses.replace(
        facts, lower=facts.lower if rising else half, upper=half if rising else facts.upper
    )
    model = ArmModel(dataclasses.replace(MODEL.facts, joints=tuple(joints)))
    arm = Follower(model, LIMITS, ForceSettings(), sensor, HOME, step)
    arm.press(request)
    samples = run(arm, sensor, step, 10.0)
    assert arm.stopped == "joint_limit"
    beyond = np.sign(way[joint]) * (samples[:, 0, joint] - half)
    assert 0.0 <= beyond.max() < 1e-3, "it brakes at once"


@STEPS
def test_successive_forces_are_relieved_by_one_relief_distance(step: float) -> None:
    sensor = Spring(gap=1.0)
    arm = follower(step, sensor, force_limit=10.0, relief_mm=2.0)
    arm.press(PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.010, speed=0.02, timeout=8.0))
    arm.hold()
    held = arm.reference.position.copy()
    for gap in (-0.015, -0.030, -0.045):  # the body comes nearer and nearer, and nobody presses Stop
        for _ in range(round(1.0 / step)):
            sensor.move_to(gap, arm.advance()[0])
    way = MODEL.forward(held).inverse() @ MODEL.forward(arm.reference.position).translation
    assert len(arm.alarms) == 3
    assert way[2] == pytest.approx(-0.002, abs=1e-4)
