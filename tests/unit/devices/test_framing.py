"""Messages in a stream of bytes, however the stream is cut."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.framing import LARGEST, LENGTH_SIZE, MessageSplitter, framed, length_of
from pcmrs.errors import PayloadError


@given(st.lists(st.binary(max_size=300), max_size=8), st.lists(st.integers(1, 40), min_size=1, max_size=10))
def test_messages_survive_any_cutting_of_their_stream(messages: list[bytes], sizes: list[int]) -> None:
    stream, splitter, found = b"".join(map(framed, messages)), MessageSplitter(), list[bytes]()
    while stream:
        for size in sizes:
            found += splitter.feed(stream[:size])
            stream = stream[size:]
    assert found == messages


@given(st.binary(max_size=300), st.binary(max_size=30))
def test_a_header_tells_the_length_of_what_follows(message: bytes, more: bytes) -> None:
    data = framed(message) + more
    assert data[LENGTH_SIZE : LENGTH_SIZE + length_of(data[:LENGTH_SIZE])] == message


def test_a_message_above_the_limit_is_refused_by_its_header() -> None:
    """Its bytes are not awaited: a sender could otherwise fill the memory."""
    assert MessageSplitter(largest=5).feed(framed(b"12345")) == [b"12345"]
    with pytest.raises(PayloadError, match="has 6 bytes, the limit is 5") as error:
        MessageSplitter(largest=5).feed(framed(b"123456")[:LENGTH_SIZE])
    assert error.value.fields["length"] == 6
    with pytest.raises(PayloadError):
        MessageSplitter().feed((LARGEST + 1).to_bytes(LENGTH_SIZE, "big"))
