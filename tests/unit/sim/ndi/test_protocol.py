"""Checksums and lines of the virtual tracker."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs_sim.ndi.protocol import LONGEST_COMMAND, Lines, crc16, reply
from tests.unit.sim.ndi.ndi_talk import Talk


@pytest.mark.parametrize(("text", "crc"), [(b"INIT:", 0xE3A5), (b"OKAY", 0xA896), (b"RESET", 0xBE6F)])
def test_the_crc_has_the_known_values(text: bytes, crc: int) -> None:
    assert crc16(text) == crc


@given(st.binary(max_size=64))
def test_the_crc_of_data_with_their_crc_is_zero(data: bytes) -> None:
    assert crc16(data + struct.pack("<H", crc16(data))) == 0


@given(st.lists(st.binary(max_size=40), max_size=30))
def test_any_bytes_in_any_pieces_give_one_answer_to_each_line(pieces: list[bytes]) -> None:
    lines, talk = Lines(), Talk()
    ended = [line for piece in pieces for line in lines.feed(piece)]
    assert ended == b"".join(pieces).replace(b"\n", b"").split(b"\r")[:-1]
    for line in ended:
        assert talk.system.answer(line)


def test_a_command_without_an_end_takes_no_more_room() -> None:
    lines, talk = Lines(), Talk()
    for _ in range(100):
        assert lines.feed(b"A" * LONGEST_COMMAND) == []
    (line,) = lines.feed(b"\r")
    assert len(line) == LONGEST_COMMAND + 1
    assert talk.system.answer(line) == reply("ERROR02")
