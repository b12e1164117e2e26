"""An arm that moves although nothing moves it."""

from __future__ import annotations

import pytest

from pcmrs.devices.standstill import LONGEST_GAP, MOVED, RELIEF_THRESHOLD, THRESHOLD, Standstill
from pcmrs.messages import JointState


def at(joint: float, time: float, *, moving: bool = False, relieving: bool = False) -> JointState:
    positions = [0.1, joint, 0.3]
    rest = [0.0] * 3
    return JointState(
        captured=time, sent=time, positions=positions, velocities=rest, torques=rest, moving=moving, relieving=relieving
    )


@pytest.fixture
def standstill() -> Standstill:
    """Of an arm that stands at 0 rad."""
    made = Standstill()
    made.watch(True)
    assert made.take(at(0.0, 0.0)) is None
    return made


def test_too_large_a_displacement_is_danger_and_names_the_joint(
    standstill: Standstill,
) -> None:
    """The event has the displacement and its limit, too."""
    assert standstill.take(at(THRESHOLD, 0.1)) is None
    event = standstill.take(at(-THRESHOLD - 0.001, 0.2))
    assert event is not None
    assert (event.code, event.danger) == (MOVED, True)
    assert event.fields == {"joint": 2, "displacement": pytest.approx(0.021), "limit": THRESHOLD}


def test_one_displacement_is_one_event(standstill: Standstill) -> None:
    events = [standstill.take(at(0.05, 0.1 * turn)) for turn in range(1, 20)]
    assert sum(event is not None for event in events) == 1


def test_a_slow_drift_is_seen_too(standstill: Standstill) -> None:
    events = [standstill.take(at(0.0001 * turn, 0.01 * turn)) for turn in range(1, 400)]
    assert sum(event is not None for event in events) == 1


def test_commanded_motion_is_safe_and_its_end_resets_the_posture(standstill: Standstill) -> None:
    """A hold that brakes the arm counts as such a motion."""
    with standstill.moving():
        assert standstill.take(at(1.0, 0.1)) is None
        with standstill.moving():
            assert standstill.take(at(2.0, 0.2)) is None
        assert standstill.take(at(3.0, 0.3)) is None, "the outer one goes on"
    assert standstill.take(at(3.0, 0.4)) is None
    assert standstill.take(at(3.05, 0.5)) is not None


def test_set_point_stream_moves_the_arm_until_it_is_braked(standstill: Standstill) -> None:
    with standstill.moving(streamed=True):
        pass
    assert standstill.take(at(1.0, 0.1)) is None
    with standstill.moving():
        pass
    assert standstill.take(at(1.0, 0.2)) is None
    assert standstill.take(at(2.0, 0.3)) is not None


def test_relief_may_move_farther_and_sets_the_posture_at_its_end(standstill: Standstill) -> None:
    assert standstill.take(at(0.05, 0.1, moving=True, relieving=True)) is None
    assert standstill.take(at(0.08, 0.2, moving=True)) is None, "it brakes"
    assert standstill.take(at(0.09, 0.3)) is None
    assert standstill.take(at(0.09 + 1.5 * THRESHOLD, 0.4)) is not None


def test_a_relief_is_bounded(standstill: Standstill) -> None:
    assert standstill.take(at(1.1 * RELIEF_THRESHOLD, 0.1, moving=True, relieving=True)) is not None


def test_a_robot_that_is_not_connected_may_be_moved_by_hand(standstill: Standstill) -> None:
    standstill.watch(False)
    assert standstill.take(at(1.0, 0.1)) is None
    standstill.watch(True)
    assert standstill.take(at(1.0, 0.2)) is None


def test_after_a_gap_nobody_can_say_when_it_moved(standstill: Standstill) -> None:
    assert standstill.take(at(1.0, 0.1 + LONGEST_GAP)) is None
