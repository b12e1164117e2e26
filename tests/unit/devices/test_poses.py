""""""

from __future__ import annotations

import asyncio
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.jumps import PoseLimits
from pcmrs.devices.lateness import AGREED
from pcmrs.devices.poses import HISTORY, PoseFeed
from pcmrs.errors import RefusalError
from pcmrs.messages import BodyPose
from pcmrs.spatial._transform import UNIT_QUATERNION_TOLERANCE
from pcmrs.testing.clock import ManualClock, settle

MAX_AGE = 0.25

LATENCY = 0.03

PERIOD = 1 / 60


def _feed() -> tuple[ManualClock, PoseFeed]:
    clock = ManualClock()
    return clock, PoseFeed(clock, MAX_AGE)


def _pose(number: int, body: str = "coil", **changes: Any) -> BodyPose:
    """Frame `number` of a tracker with a clock of its own."""
    captured = 5.0 + number * PERIOD
    pose = BodyPose(body=body, frame_number=number, captured=captured, sent=captured + LATENCY, valid=True)
    return msgspec.structs.replace(pose, **changes)


def _reason(feed: PoseFeed, body: str = "coil") -> str:
    with pytest.raises(RefusalError) as refused:
        feed.newest(body)
    return refused.value.refusal_code


def test_a_body_that_was_never_seen_is_missing() -> None:
    _, feed = _feed()
    assert _reason(feed) == "pose_missing"
    assert not feed.seen("coil")


async def test_pose_age_includes_the_latency_of_the_tracker() -> None:
    clock, feed = _feed()
    feed.update(_pose(1, position=(0.1, 0.2, 0.3)))
    assert feed.newest("coil").translation.tolist() == [0.1, 0.2, 0.3]
    await clock.advance(MAX_AGE - LATENCY - 1e-6)
    assert feed.seen("coil")
    await clock.advance(2e-6)
    assert _reason(feed) == "pose_stale"


async def test_a_refusal_says_age_limit_and_why() -> None:
    clock, feed = _feed()
    feed.update(_pose(1))
    feed.update(_pose(2, valid=False, reason="occluded"))
    await clock.advance(1.0)
    with pytest.raises(RefusalError, match=r"1\.030 s old, the limit is 0\.250 s \(coil: occluded\)") as refused:
        feed.newest("coil")
    assert refused.value.fields["age"] == pytest.approx(1.03)


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        (_pose(11, valid=False, reason="occluded"), "occluded"),
        (_pose(11, valid=False), "invalid"),
        (_pose(10), "frame_not_advancing"),
        (_pose(9), "frame_not_advancing"),
        (_pose(11, captured=_pose(10).captured), "stamp_not_advancing"),
        (_pose(11, captured=_pose(3).captured), "stamp_not_advancing"),
        (_pose(11, sent=_pose(11).captured - 0.001), "stamp_reversed"),
        (_pose(11, captured=math.nan), "stamp_reversed"),
        (_pose(11, sent=math.nan), "stamp_reversed"),
        (_pose(11, sent=math.inf), "stamp_reversed"),
        (_pose(11, captured=math.inf, sent=math.inf), "stamp_reversed"),
        (_pose(11, captured=-math.inf), "stamp_reversed"),
        (_pose(11, position=(0.0, math.nan, 0.0)), "no_pose"),
        (_pose(11, position=(0.0, math.inf, 0.0)), "no_pose"),
        (_pose(11, quat_wxyz=(0.0, 0.0, 0.0, 0.0)), "no_pose"),
        (_pose(11, quat_wxyz=(1.1, 0.0, 0.0, 0.0)), "no_pose"),
        (_pose(11, quat_wxyz=(math.nan, 0.0, 0.0, 0.0)), "no_pose"),
    ],
)
async def test_implausible_pose_is_dropped_and_counted(pose: BodyPose, reason: str) -> None:
    clock, feed = _feed()
    feed.update(_pose(10, position=(1.0, 0.0, 0.0)))
    feed.update(pose)
    assert feed.dropped == {reason: 1}
    assert feed.newest("coil").translation.tolist() == [1.0, 0.0, 0.0]
    await clock.advance(MAX_AGE)
    assert _reason(feed) == "pose_stale"
    feed.update(_pose(12 + round(MAX_AGE / PERIOD), position=(2.0, 0.0, 0.0)))
    assert feed.newest("coil").translation.tolist() == [2.0, 0.0, 0.0]


async def test_a_frozen_tracker_that_keeps_sending_is_stale() -> None:
    clock, feed = _feed()
    for _ in range(60):
        feed.update(_pose(1))
        await clock.advance(PERIOD)
    assert _reason(feed) == "pose_stale"
    assert feed.dropped["frame_not_advancing"] == 59


@given(
    st.lists(st.tuples(st.integers(0, 50), st.floats(), st.floats(), st.booleans(), st.floats(-1.5, 1.5)), max_size=40)
)
def test_accepted_poses_advance_whatever_arrives(arrivals: list[tuple[int, float, float, bool, float]]) -> None:
    _, feed = _feed()
    believed: list[tuple[int, float]] = []
    for number, captured, sent, valid, w in arrivals:
        before = feed.dropped.total()
        quat = (w, math.sqrt(max(0.0, 1.0 - w * w)), 0.0, 0.0)
        feed.update(
            BodyPose(body="coil", frame_number=number, captured=captured, sent=sent, valid=valid, quat_wxyz=quat)
        )
        if feed.dropped.total() == before:
            believed.append((number, captured))
            assert valid
            assert abs(w) <= 1.0 + UNIT_QUATERNION_TOLERANCE
            assert captured <= sent < math.inf
    assert believed == sorted(set(believed))
    assert [captured for _, captured in believed] == sorted({captured for _, captured in believed})
    assert len(believed) + feed.dropped.total() == len(arrivals)


async def test_collected_frames_are_new_and_show_all_bodies() -> None:
    clock, feed = _feed()
    feed.update(_pose(1))
    feed.update(_pose(1, "body_ref"))
    collecting = asyncio.create_task(feed.collect(["coil", "body_ref"], 3, timeout=1.0))
    await settle()
    for number in range(2, 10):
        await clock.advance(PERIOD)
        feed.update(_pose(number, position=(float(number), 0.0, 0.0)))
        if number % 2 == 0:  # body_ref is hidden in every other frame
            feed.update(_pose(number, "body_ref"))
    frames = await collecting
    # Frame 2 came after the question, but was captured before it.
    assert [frame["coil"].translation[0] for frame in frames] == [4.0, 6.0, 8.0]


async def test_missing_frames_are_refused_with_their_reason() -> None:
    clock, feed = _feed()
    collecting = asyncio.create_task(feed.collect(["coil", "pointer"], 2, timeout=0.5))
    await settle()
    for number in range(1, 40):
        feed.update(_pose(number))
        feed.update(_pose(number, "pointer", valid=False, reason="occluded"))
        await clock.advance(PERIOD)
    with pytest.raises(RefusalError, match=r"0 of 2 frames .* within 0\.5 s \(pointer: occluded\)") as refused:
        await collecting
    assert refused.value.refusal_code == "pose_missing"


async def test_recent_means_the_last_frames_since_the_arm_rests() -> None:
    clock, feed = _feed()
    for number in range(1, 11):
        await clock.advance(PERIOD)
        for body in ("coil", "body_ref"):
            feed.update(_pose(number, body, position=(float(number), 0.0, 0.0)))
    mean = feed.recent(["coil", "body_ref"], 4, since=0.0)["coil"]
    assert mean.translation[0] == pytest.approx(np.mean([7.0, 8.0, 9.0, 10.0]))
    two_frames_ago = clock.monotonic() - LATENCY - 1.5 * PERIOD
    assert feed.recent(["coil"], 4, since=two_frames_ago)["coil"].translation[0] == pytest.approx(9.5)
    with pytest.raises(RefusalError) as refused:
        feed.recent(["coil"], 4, since=clock.monotonic())
    assert refused.value.refusal_code == "pose_missing"


def test_only_the_newest_frames_are_kept() -> None:
    _, feed = _feed()
    for number in range(1, HISTORY + 11):
        feed.update(_pose(number, position=(float(number), 0.0, 0.0)))
    oldest = feed.recent(["coil"], 10 * HISTORY, since=0.0)["coil"].translation[0]
    assert oldest == pytest.approx(np.mean(np.arange(11, HISTORY + 11)))


async def test_restarted_tracker_is_trusted_and_its_numbers_continue() -> None:
    clock, feed = _feed()
    feed.update(_pose(1000, session="first"))
    await clock.advance(0.1)
    for number in range(1, 4):
        await clock.advance(PERIOD)
        feed.update(_pose(number, session="second"))
    assert feed.seen("coil")
    assert len(feed.frames_after(1000, ["coil"])) == 3, "who has seen frame 1000 gets the later ones"
    assert feed.dropped.total() == 0


async def test_late_frames_of_an_earlier_session_never_count() -> None:
    clock, feed = _feed()
    for number, session in enumerate(("first", "second", "third")):
        feed.update(_pose(number, session=session, position=(float(number), 0.0, 0.0)))
    await clock.advance(PERIOD)
    for late in (_pose(50, session="first"), _pose(51, session="second", valid=False, reason="occluded")):
        feed.update(late)
    assert feed.dropped == {"earlier_session": 2}
    assert feed.newest("coil").translation[0] == 2.0


async def test_frames_before_a_restart_are_not_paired_with_later_ones() -> None:
    clock, feed = _feed()
    for body in ("coil", "body_ref"):
        feed.update(_pose(5, body, session="first"))
    for number in range(1, 7):  # the reference is not seen any more
        feed.update(_pose(number, session="second"))
        await clock.advance(PERIOD)
    assert feed.frames_after(0, ("coil", "body_ref")) == []
    assert _reason(feed, "body_ref") == "pose_missing"
    feed.update(_pose(7, "body_ref", session="second"))
    assert feed.seen("body_ref")


async def test_rejected_body_is_accepted_after_a_tracker_restart() -> None:
    """The daemon has started while pointer and reference were taken for each other, and the pointer is hidden now."""
    clock = ManualClock()
    feed = PoseFeed(clock, MAX_AGE, PoseLimits(speed=2.0, turn=20.0))
    feed.update(_pose(1, "pointer", session="first"))
    for number in range(2, 30):
        await clock.advance(PERIOD)
        feed.update(_pose(number, "body_ref", session="first"))
    assert feed.dropped["swapped"] == 28
    for number in range(1, 30):
        await clock.advance(PERIOD)
        feed.update(_pose(number, "body_ref", session="second"))
    assert feed.seen("body_ref")


async def test_one_frame_stamped_an_hour_ahead_affects_no_later_one() -> None:
    clock, feed = _feed()
    feed.update(_pose(1))
    await clock.advance(PERIOD)
    feed.update(_pose(2, captured=_pose(2).captured + 3600.0, sent=_pose(2).sent + 3600.0))
    assert feed.dropped == {"stamp_ahead": 1}
    for number in range(3, 40):
        await clock.advance(PERIOD)
        feed.update(_pose(number))
        assert feed.seen("coil")
    assert feed.dropped == {"stamp_ahead": 1}


async def test_a_first_frame_stamped_an_hour_ahead_costs_a_few_frames() -> None:
    """The tracker goes on in its session, and the daemon has started with just that frame."""
    clock, feed = _feed()
    for body in ("coil", "body_ref"):
        wrong = _pose(1, body)
        feed.update(msgspec.structs.replace(wrong, captured=wrong.captured + 3600.0, sent=wrong.sent + 3600.0))
    for number in range(2, 2 + AGREED):
        await clock.advance(PERIOD)
        for body in ("coil", "body_ref"):
            feed.update(_pose(number, body))
    assert feed.dropped == {"stamp_not_advancing": 2 * (AGREED - 1)}
    for body in ("coil", "body_ref"):
        assert feed.seen(body)
        assert feed.last_seen(body) == pytest.approx(clock.monotonic() - LATENCY)


async def test_one_frame_stamped_an_hour_back_is_dropped() -> None:
    clock, feed = _feed()
    for number in range(1, 30):
        await clock.advance(PERIOD)
        pose = _pose(number)
        back = 3600.0 if number % AGREED == 0 else 0.0
        feed.update(msgspec.structs.replace(pose, captured=pose.captured - back, sent=pose.sent - back))
    assert feed.dropped == {"stamp_not_advancing": 2}
    assert feed.seen("coil")


async def test_after_late_first_frames_quicker_ones_are_soon_accepted() -> None:
    clock, feed = _feed()
    await clock.advance(5.0)  # so long the first frame was on its way
    feed.update(_pose(1))
    for number in range(2, AGREED + 1):
        await clock.advance(PERIOD)
        feed.update(_pose(number + 300))
    assert feed.dropped == {"stamp_ahead": AGREED - 1}
    await clock.advance(PERIOD)
    feed.update(_pose(AGREED + 301))
    assert feed.dropped == {"stamp_ahead": AGREED - 1}
    assert feed.newest("coil") is not None
