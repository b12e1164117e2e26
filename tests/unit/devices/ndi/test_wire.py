"""Reports of the reader process, however their stream is cut."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.ndi.wire import LARGEST as LARGEST_REPORT
from pcmrs.devices.ndi.wire import Unpacker, pack
from pcmrs.errors import PayloadError
from tests.unit.devices.ndi_frames import reports


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
