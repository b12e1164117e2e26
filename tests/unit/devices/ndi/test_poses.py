"""From frames of the tracker to poses, with the reason of each that is not valid."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest
from hypothesis import given

from pcmrs.devices.ndi.poses import FRAMES_TO_RESTART, FROZEN_TIME, FrameReader
from pcmrs.devices.ndi.wire import NdiFrame, ToolFrame
from tests.unit.devices.ndi_frames import frames

LATENCY = 0.04

SEEN = ToolFrame("coil", 7, 0x31, (0.5, -0.5, 0.5, -0.5, 100.0, -200.0, -1500.0, 0.25))


def _reader() -> FrameReader:
    return FrameReader(LATENCY, max_error=0.001)


def _frame(number: int, arrived: float, **changes: Any) -> NdiFrame:
    return NdiFrame(arrived, 0, [msgspec.structs.replace(SEEN, frame_number=number, **changes)])


def test_a_pose_is_in_metres_and_as_old_as_the_tracker_takes() -> None:
    (pose,) = _reader().poses(_frame(7, arrived=10.0), now=10.002)
    assert pose.valid
    assert pose.position == (0.1, -0.2, -1.5)
    assert pose.quat_wxyz == (0.5, -0.5, 0.5, -0.5)
    assert pose.error == 0.00025
    assert pose.frame_number == 7
    assert pose.captured == pytest.approx(10.0 - LATENCY)
    assert pose.sent == 10.002


@pytest.mark.parametrize(
    ("status", "system", "measured", "reason"),
    [
        (0x31, 0, None, "missing"),
        (0x71, 0, None, "out_of_volume"),
        (0x71, 0, SEEN.numbers, "out_of_volume"),
        (0xB1, 0, SEEN.numbers, "partially_out"),
        (0x231, 0, SEEN.numbers, "interference"),
        (0x31, 0x2, SEEN.numbers, "interference"),
        (0x31, 0x100, SEEN.numbers, "temperature"),
        (0x31, 0, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.001), "fit_error"),
        (0x31, 0, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.nan), "fit_error"),
    ],
)
def test_status_bits_are_reasons(status: int, system: int, measured: Any, reason: str) -> None:
    (pose,) = _reader().poses(NdiFrame(1.0, system, [ToolFrame("coil", 1, status, measured)]), now=1.0)
    assert not pose.valid
    assert pose.reason == reason
    assert pose.body == "coil"


def test_a_frame_is_taken_once_however_often_it_is_answered() -> None:
    reader = _reader()
    assert [len(reader.poses(_frame(1, 0.001 * i), now=1.0)) for i in range(5)] == [1, 0, 0, 0, 0]
    assert len(reader.poses(_frame(2, 0.006), now=1.0)) == 1
    assert reader.refused.total() == 0


def test_frozen_tracker_is_reported_at_intervals() -> None:
    reader = _reader()
    told = [pose for i in range(400) for pose in reader.poses(_frame(1, 0.005 * i), now=2.0)]
    assert told[0].valid
    assert [pose.reason for pose in told[1:]] == ["frozen"] * int(2.0 / FROZEN_TIME - 1)
    assert reader.refused["frozen"] == len(told) - 1


def test_a_reversed_frame_is_refused_and_counted() -> None:
    reader = _reader()
    reader.poses(_frame(5, 0.1), now=1.0)
    (pose,) = reader.poses(_frame(4, 0.2), now=1.0)
    assert (pose.valid, pose.reason) == (False, "reversed")
    assert reader.refused["reversed"] == 1
    assert reader.poses(_frame(6, 0.3), now=1.0)[0].valid


def test_numbers_continue_after_a_tracker_was_set_up_again() -> None:
    reader = _reader()
    assert reader.poses(_frame(500, 0.1), now=1.0)[0].frame_number == 500
    reader.restart()
    assert [reader.poses(_frame(n, 1.0 + n), now=9.0)[0].frame_number for n in (3, 4, 6)] == [501, 502, 504]
    reader.restart()
    assert reader.poses(_frame(7, 9.0), now=9.0)[0].frame_number == 505
    assert reader.refused.total() == 0


def test_frame_count_that_restarts_is_accepted_after_few_frames() -> None:
    reader = _reader()
    reader.poses(_frame(500, 0.1), now=1.0)
    found = [reader.poses(_frame(n, 0.1 + 0.01 * n), now=9.0)[0] for n in range(1, FRAMES_TO_RESTART + 3)]
    assert [pose.valid for pose in found] == [False] * (FRAMES_TO_RESTART - 1) + [True] * 3
    assert [pose.frame_number for pose in found[-3:]] == [501, 502, 503]


def test_tracker_that_runs_backwards_is_never_accepted() -> None:
    reader = _reader()
    reader.poses(_frame(500, 0.1), now=1.0)
    assert not any(reader.poses(_frame(500 - n, 0.1 + 0.01 * n), now=9.0)[0].valid for n in range(1, 400))


@given(frames)
def test_no_frame_is_too_strange(frame: NdiFrame) -> None:
    reader = _reader()
    for pose in reader.poses(frame, now=1.0) + reader.poses(frame, now=1.0):
        assert pose.valid == (pose.reason is None)
        assert not pose.valid or pose.error <= 0.001
