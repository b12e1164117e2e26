""""""

from __future__ import annotations

import asyncio
import itertools
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyigtl.messages import TransformMessage

from pcmrs.devices.plus.frames import HEADER_BYTES, MAX_BODY, MessageReader
from pcmrs.devices.plus.messages import (
    StartTrackingDataMessage,
    StatusMessage,
    TrackingDataMessage,
    readings,
    text_message,
)
from pcmrs.errors import PayloadError
from pcmrs.spatial import Transform
from tests.support import openigtlink_bytes as wire

KINDS = ("TRANSFORM", "POINT", "STRING", "STATUS", "TDATA")

MATRIX = np.array([[0.0, -1.0, 0.0, 10.5], [1.0, 0.0, 0.0, -20.25], [0.0, 0.0, 1.0, 300.125], [0.0, 0.0, 0.0, 1.0]])

HEAD: dict[str, Any] = {"timestamp": wire.STAMP}


class Ending(asyncio.StreamReader):
    """A stream that is not read again and again after its end."""

    def __init__(self) -> None:
        super().__init__()
        self._reads_after_end = 0

    async def read(self, n: int = -1) -> bytes:
        self._reads_after_end += self.at_eof()
        assert self._reads_after_end <= 1, "what is at its end brings nothing more"
        return await super().read(n)


def read_all(data: bytes, cuts: list[int] | None = None) -> list[Any]:
    """What the reader makes of `data` that comes in pieces: messages, None for skipped ones, and errors."""

    async def read() -> list[Any]:
        stream = Ending()
        places = [0, *sorted(cuts or []), len(data)]
        for start, end in itertools.pairwise(places):
            stream.feed_data(data[start:end])
        stream.feed_eof()
        reader, found = MessageReader(stream, KINDS), list[Any]()
        while True:
            try:
                found.append(await reader.read())
            except PayloadError as error:
                found.append(error)
            except (asyncio.IncompleteReadError, ConnectionError) as error:
                return [*found, error]

    return asyncio.run(read())


def test_the_checksum_is_that_of_ecma_182() -> None:
    assert wire.crc64(b"123456789") == 0x6C40DF5F0B497347


def test_messages_are_written_as_the_protocol_says() -> None:
    assert TransformMessage(MATRIX, device_name="CoilToImage", **HEAD).pack() == wire.transform("CoilToImage", MATRIX)
    assert text_message("hello", device_name="S", **HEAD).pack() == wire.string("S", "hello")
    sent = StatusMessage(3, "latched", "Stopped.", device_name="PcmrsStatus", **HEAD).pack()
    assert sent == wire.status("PcmrsStatus", 3, "latched", "Stopped.")
    tools = {"CoilToTracker": MATRIX, "StylusToTracker": np.eye(4)}
    sent = TrackingDataMessage(tools, device_name="T", **HEAD).pack()
    assert sent == wire.message("TDATA", "T", wire.tracking_data("T", tools))
    start = StartTrackingDataMessage(device_name="PCMRS", **HEAD).pack()
    assert start == wire.with_metadata("STT_TDATA", "PCMRS", struct.pack(">i32s", 0, b""), {})


def test_messages_are_read_as_the_protocol_says() -> None:
    data = wire.transform("A", MATRIX) + wire.points("P", [(1, 2, 3), (4, 5, 6.5)], ["F-1", "F-2"])
    data += wire.string("S", "stop") + wire.status("Q", 5, "denied", "No.")
    transform, points, string, status, end = read_all(data)
    assert (transform.device_name, transform.timestamp) == ("A", wire.STAMP)
    np.testing.assert_array_equal(transform.matrix, MATRIX)
    assert (points.positions, points.names) == ([(1.0, 2.0, 3.0), (4.0, 5.0, 6.5)], ["F-1", "F-2"])
    assert string.string == "stop"
    assert (status.code, status.error_name, status.text) == (5, "denied", "No.")
    assert isinstance(end, asyncio.IncompleteReadError)


def test_letters_that_ascii_lacks_are_replaced() -> None:
    sent = text_message("5 °", device_name="S", **HEAD).pack()
    assert sent == wire.string("S", "5 ?")
    assert read_all(StatusMessage(2, "größer", "ß", device_name="Q", **HEAD).pack())[0].error_name == "gr??er"


@given(cuts=st.lists(st.integers(0, 600), max_size=12))
def test_however_a_stream_is_cut_its_messages_are_the_same(cuts: list[int]) -> None:
    data = wire.transform("A", MATRIX) + wire.message("IMAGE", "I", b"x" * 200) + wire.string("S", "stop")
    first, skipped, last, _ = read_all(data, [cut for cut in cuts if cut < len(data)])
    assert (first.device_name, skipped, last.string) == ("A", None, "stop")


async def test_a_read_that_is_cancelled_loses_nothing() -> None:
    stream, data = asyncio.StreamReader(), wire.transform("A", MATRIX)
    reader = MessageReader(stream, KINDS)
    for end in (30, HEADER_BYTES - 30, 7):
        stream.feed_data(data[:end])
        data = data[end:]
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0):
                await reader.read()
        stream.feed_data(data[:1])
        data = data[1:]
    stream.feed_data(data)
    message = await reader.read()
    assert message is not None
    np.testing.assert_array_equal(message.matrix, MATRIX)


async def test_read_cancelled_in_a_skipped_message_finds_the_next_one() -> None:
    """Its body looks like a header that nobody can read."""
    stream, skipped = asyncio.StreamReader(), wire.message("IMAGE", "I", bytes(200))
    reader = MessageReader(stream, KINDS)
    for data in (skipped[:100], skipped[100:150]):
        stream.feed_data(data)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0):
                await reader.read()
    stream.feed_data(skipped[150:] + wire.string("S", "stop"))
    assert await reader.read() is None
    message = await reader.read()
    assert message is not None
    assert message.string == "stop"


def test_a_damaged_message_is_refused_and_the_next_one_read() -> None:
    damaged = bytearray(wire.transform("A", MATRIX))
    damaged[-1] ^= 1
    error, message, _ = read_all(bytes(damaged) + wire.transform("B", MATRIX))
    assert isinstance(error, PayloadError)
    assert message.device_name == "B"


@pytest.mark.parametrize(
    "body",
    [
        ("TRANSFORM", b"\0" * 47),
        ("TRANSFORM", b""),
        ("POINT", b"\0" * 137),
        ("STRING", b"\0\3\0\5stop"),
        ("STRING", b"\0"),
        ("STRING", b"\0\7\0\4stop"),
        ("STRING", b"\0\3\0\1\xff"),
        ("STATUS", b"\0" * 29),
        ("TDATA", b"\0" * 71),
    ],
)
def test_body_that_does_not_match_its_type_is_refused(body: tuple[str, bytes]) -> None:
    error, message, _ = read_all(wire.message(body[0], "A", body[1]) + wire.transform("B", MATRIX))
    assert isinstance(error, PayloadError)
    assert message.device_name == "B"


def test_data_that_is_no_openigtlink_ends_the_connection() -> None:
    assert isinstance(read_all(b"GET / HTTP/1.1\r\n" + b"x" * 100)[0], ConnectionError)
    assert isinstance(read_all(b"\0\1" + b"\xff" * 100)[0], ConnectionError)


def test_a_gigantic_body_is_skipped_without_being_kept() -> None:
    header = wire.HEADER.pack(1, b"STRING", b"S", 0, 0, 1 << 40, 0)
    (end,) = read_all(header + b"x" * (MAX_BODY // 4))
    assert isinstance(end, asyncio.IncompleteReadError)


@given(st.binary(max_size=300), st.sampled_from(KINDS), st.sampled_from([1, 2]))
def test_no_body_breaks_the_reader(body: bytes, kind: str, version: int) -> None:
    found = read_all(wire.message(kind, "A", body, version=version) + wire.string("S", "stop"))
    assert found[1].string == "stop"
    if kind in ("TRANSFORM", "TDATA") and not isinstance(found[0], PayloadError):
        for reading in readings(found[0]).values():
            assert isinstance(reading, Transform | str)


@given(st.binary(max_size=400))
def test_no_bytes_break_the_reader(data: bytes) -> None:
    assert isinstance(read_all(data)[-1], asyncio.IncompleteReadError | ConnectionError)
