"""Messages of the bus in a recording, byte for byte."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import FileFormatError
from pcmrs.recording import raw


@given(st.floats(allow_nan=False), st.binary(max_size=300))
def test_a_message_of_the_bus_comes_back_as_it_was(monotonic: float, payload: bytes) -> None:
    encoded = raw.encode(monotonic, payload)
    assert raw.decode(encoded) == (monotonic, payload)
    for cut in range(len(encoded)):
        with pytest.raises(FileFormatError):
            raw.decode(encoded[:cut])


def test_bus_message_schema_is_what_protobuf_would_write() -> None:
    from google.protobuf import descriptor_pb2

    expected = descriptor_pb2.FileDescriptorSet()
    file = expected.file.add(name="pcmrs/bus_message.proto", package="pcmrs", syntax="proto3")
    message = file.message_type.add(name="BusMessage")
    message.field.add(name="monotonic", number=1, label=1, type=1)
    message.field.add(name="payload", number=2, label=1, type=12)
    assert raw.schema() == expected.SerializeToString(deterministic=True)
