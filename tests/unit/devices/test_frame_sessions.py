"""When a tracker's frames belong to a new session."""

from __future__ import annotations

from collections.abc import Iterable

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices._frame_sessions import FRAMES_TO_RESTART, FrameSessions
from pcmrs.messages import BodyPose


def _sessions(numbers: Iterable[int], sent: Iterable[float] | None = None) -> list[str]:
    sessions, named = FrameSessions(), list[str]()
    for number, time in zip(numbers, sent or (float(i) for i in range(10_000)), strict=False):
        pose = BodyPose(body="coil", frame_number=number, captured=time, sent=time, valid=True)
        named.append(sessions.named([pose])[0].session)
    return named


def test_each_start_of_the_node_is_a_session() -> None:
    assert len(set(_sessions(range(100)))) == 1
    assert _sessions([1]) != _sessions([1])


def test_restarted_frame_count_starts_a_session_after_few_frames() -> None:
    named = _sessions([500, 501, *range(1, 20)])
    assert named.index(named[-1]) == 1 + FRAMES_TO_RESTART
    assert len(set(named)) == 2


def test_one_frame_with_a_wrong_number_costs_a_few_frames_only() -> None:
    named = _sessions([5, 2**31, *range(6, 20)])
    assert named[0] == named[1] != named[-1]
    assert len(set(named[1 + FRAMES_TO_RESTART :])) == 1


def test_one_frame_with_a_wrong_stamp_begins_no_session() -> None:
    """Nothing that was known of the bodies is forgotten because of it."""
    for wrong in (3601.0, -3601.0):
        assert len(set(_sessions(range(20), [0.0, 1.0, wrong, *(float(i) for i in range(3, 20))]))) == 1


def test_first_frame_with_a_wrong_stamp_costs_only_a_few_frames() -> None:
    named = _sessions(range(20), [3601.0, *(float(i) for i in range(1, 20))])
    assert named[0] != named[-1]
    assert len(set(named[FRAMES_TO_RESTART:])) == 1


def test_stamps_that_go_back_for_good_begin_a_session() -> None:
    """A clock that was set back, or one that was set right after it had gone ahead for several frames."""
    for ahead in (100.0, 3600.0):
        times = [*(ahead + i for i in range(5)), *(float(i) for i in range(5, 20))]
        named = _sessions(range(20), times)
        assert len(set(named)) == 2
        assert named.index(named[-1]) == 4 + FRAMES_TO_RESTART


@given(st.lists(st.integers(0, 50), min_size=1, max_size=60).map(lambda found: sorted(found, reverse=True)))
def test_a_tracker_that_runs_backwards_or_is_frozen_begins_none(numbers: list[int]) -> None:
    assert len(set(_sessions(numbers))) == 1
