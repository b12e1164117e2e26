"""Frames of the virtual tracker, byte for byte."""

from __future__ import annotations

import struct

import msgspec
import pytest

from pcmrs_sim.ndi.protocol import crc16
from tests.unit.sim.ndi.ndi_talk import POSE, Talk


def test_the_bytes_of_a_frame_in_floats() -> None:
    talk = Talk()
    talk.track("coil", "pointer")
    answer = talk.raw("BX:0001")
    body = bytes((2, 1, 1)) + struct.pack("<8f", 0.5, -0.5, 0.5, -0.5, -38.9, 586.17, -1234.56, 0.12)
    body += struct.pack("<II", 0x31, 258) + bytes((2, 2)) + struct.pack("<II", 0x31, 258) + bytes(2)
    header = b"\xc4\xa5" + struct.pack("<H", len(body))
    assert answer == header + struct.pack("<H", crc16(header)) + body + struct.pack("<H", crc16(body))


@pytest.mark.parametrize(
    ("reason", "port", "system"),
    [
        ("out_of_volume", 0x71, 0),
        ("partially_out", 0xB1, 0),
        ("interference", 0x31, 0x0002),
        ("temperature", 0x31, 0x0100),
    ],
)
def test_a_reason_is_a_bit_of_the_status(reason: str, port: int, system: int) -> None:
    talk = Talk([msgspec.structs.replace(POSE, valid=False, reason=reason)])
    talk.track("coil")
    assert talk.ask("TX:0001") == f"0101MISSING{port:08X}00000102\n{system:04X}"
