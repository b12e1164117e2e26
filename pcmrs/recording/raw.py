"""Messages of the bus, byte for byte, as a protobuf message that every reader of MCAP can show.

message BusMessage {
  double monotonic = 1;
  bytes payload = 2;
}

Two fields need no library: protobuf's wire format is tags, and lengths as varints
(https://protobuf.dev/programming-guides/encoding).
"""

from __future__ import annotations

import struct
from typing import Final

from pcmrs.errors import FileFormatError

PREFIX: Final = "bus/"
"""Prefix of the topics: messages on the relative key ``state/fsm`` have the topic ``bus/state/fsm``."""

NAME: Final = "pcmrs.BusMessage"

_DOUBLE, _BYTES, _OPTIONAL = 1, 12, 1  # of google.protobuf.FieldDescriptorProto
_MONOTONIC = struct.Struct("<Bd")
_TAG_MONOTONIC, _TAG_PAYLOAD = 0x09, 0x12


def encode(monotonic: float, payload: bytes) -> bytes:
    """Return an encoded ``BusMessage``.

    Args:
        monotonic: Time of arrival, s of the recorder's monotonic clock.
        payload: Payload on the bus.
    """
    return _MONOTONIC.pack(_TAG_MONOTONIC, monotonic) + _block(2, payload)


def decode(data: bytes) -> tuple[float, bytes]:
    """Return monotonic time, s, and payload of an encoded ``BusMessage``.

    Raises:
        FileFormatError: The data is not such a message.
    """
    try:
        tag, monotonic = _MONOTONIC.unpack_from(data)
        length, start = _read_varint(data, _MONOTONIC.size + 1)
        payload_tag = data[_MONOTONIC.size]
    except (struct.error, IndexError):
        raise _no_message(data) from None
    if (tag, payload_tag) != (_TAG_MONOTONIC, _TAG_PAYLOAD) or start + length != len(data):
        raise _no_message(data)
    return monotonic, data[start:]


def schema() -> bytes:
    """Return the ``FileDescriptorSet`` of `NAME`, as MCAP requires it."""
    package, _, name = NAME.rpartition(".")
    fields = _field("monotonic", 1, _DOUBLE) + _field("payload", 2, _BYTES)
    message = _block(4, _text(1, name) + fields)
    return _block(1, _text(1, "pcmrs/bus_message.proto") + _text(2, package) + message + _text(12, "proto3"))


def _field(name: str, number: int, kind: int) -> bytes:
    return _block(2, _text(1, name) + _number(3, number) + _number(4, _OPTIONAL) + _number(5, kind))


def _text(field: int, text: str) -> bytes:
    return _block(field, text.encode())


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _block(field: int, content: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    """Return the number that starts at `at`, and the index after it. Raises `IndexError` if it does not end."""
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at


def _no_message(data: bytes) -> FileFormatError:
    return FileFormatError(f"{len(data)} bytes of the recording are not a {NAME}: it is of another program.")
