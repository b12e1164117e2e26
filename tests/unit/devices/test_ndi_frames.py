"""From the bytes of the reader process to poses, and from files to tool definitions."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.ndi.poses import FRAMES_TO_RESTART, FROZEN_TIME, FrameReader
from pcmrs.devices.ndi.tools import LARGEST, placeholder, read_tools
from pcmrs.devices.ndi.wire import LARGEST as LARGEST_REPORT
from pcmrs.devices.ndi.wire import Failed, NdiFrame, ToolFrame, TrackerReady, Unpacker, pack
from pcmrs.errors import ConfigurationError, PayloadError

LATENCY = 0.04
SEEN = ToolFrame("coil", 7, 0x31, (0.5, -0.5, 0.5, -0.5, 100.0, -200.0, -1500.0, 0.25))

words = st.integers(0, 2**32 - 1)
numbers = st.tuples(*[st.floats()] * 8)
tools = st.builds(ToolFrame, st.sampled_from(["coil", "pointer"]), words, words, st.none() | numbers)
frames = st.builds(NdiFrame, st.floats(0.0, 1e6), words, st.lists(tools, max_size=4))
reports = st.one_of(frames, st.builds(TrackerReady, st.text(), st.booleans()), st.builds(Failed, st.text()))


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


@given(st.lists(reports, max_size=5), st.lists(st.integers(1, 50), min_size=1))
def test_reports_survive_any_cutting_of_the_stream(sent: list[Any], sizes: list[int]) -> None:
    stream, unpacker, got = b"".join(map(pack, sent)), Unpacker(), list[Any]()
    while stream:
        for size in sizes:
            got += unpacker.feed(stream[:size])
            stream = stream[size:]
    assert [msgspec.msgpack.encode(each) for each in got] == [msgspec.msgpack.encode(each) for each in sent]


@given(st.lists(st.binary(max_size=60), max_size=10))
def test_invalid_report_raises_only_payload_errors(pieces: list[bytes]) -> None:
    unpacker = Unpacker()
    for piece in pieces:
        try:
            unpacker.feed(piece)
        except PayloadError:
            return


def test_a_report_that_claims_to_be_huge_is_refused_at_once() -> None:
    with pytest.raises(PayloadError):
        Unpacker().feed((LARGEST_REPORT + 1).to_bytes(4, "big"))


def test_a_tool_definition_is_read_whole_and_its_hash_checked(tmp_path: Path) -> None:
    file = tmp_path / "coil.rom"
    file.write_bytes(placeholder("coil"))
    digest = hashlib.sha256(placeholder("coil")).hexdigest()
    assert read_tools({"coil": str(file)}, {"coil": digest.upper()}) == {"coil": placeholder("coil")}
    with pytest.raises(ConfigurationError, match=r"ndi\.tools\.coil: .* is not the agreed tool definition"):
        read_tools({"coil": str(file)}, {"coil": "0" * 64})
    with pytest.raises(ConfigurationError, match=r"pointer, which ndi\.tools does not"):
        read_tools({"coil": str(file)}, {"pointer": digest})


@pytest.mark.parametrize("content", [b"", b"something else", b"NDI".ljust(LARGEST + 1, b"x")])
def test_invalid_tool_definition_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "coil.rom"
    file.write_bytes(content)
    with pytest.raises(ConfigurationError, match="is not a tool definition"):
        read_tools({"coil": str(file)}, {})


def test_a_tool_definition_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"ndi\.tools\.coil: .*none\.rom cannot be read: No such file"):
        read_tools({"coil": str(tmp_path / "none.rom")}, {})
    with pytest.raises(ConfigurationError, match="Is a directory"):
        read_tools({"coil": str(tmp_path)}, {})
