"""The virtual tracker's protocol: byte for byte, and whatever is sent to it."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Sequence

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.devices.ndi.tools import placeholder
from pcmrs.messages import BodyPose
from pcmrs_sim.cell import running_cell
from pcmrs_sim.faults import inject
from pcmrs_sim.ndi.protocol import LONGEST_COMMAND, Lines, crc16, reply
from pcmrs_sim.ndi.server import serve_ndi
from pcmrs_sim.ndi.system import MOST_HANDLES, NdiSystem
from pcmrs_sim.tracker_faults import BODIES

POSE = BodyPose(
    body="coil",
    frame_number=258,
    captured=0.0,
    sent=0.0,
    valid=True,
    position=(-0.0389, 0.58617, -1.23456),
    quat_wxyz=(0.5, -0.5, 0.5, -0.5),
    error=0.00012,
)
UNSEEN = BodyPose(body="pointer", frame_number=258, captured=0.0, sent=0.0, valid=False, reason="occluded")

commands = st.sampled_from(
    [
        "INIT",
        "RESET",
        "VER",
        "COMM",
        "BEEP",
        "PHRQ",
        "PHSR",
        "PHINF",
        "PHF",
        "PVWR",
        "PINIT",
        "PENA",
        "PDIS",
        "TSTART",
        "TSTOP",
        "TX",
        "BX",
        "GETINFO",
        "X",
    ]
)
parameters = st.one_of(
    st.sampled_from(["", "0", "0001", "01", "01D", "02", "FF", "010000" + "00" * 64, "*********1****"]),
    st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=160),
)


def _line(command: str) -> bytes:
    """As the library sends it: with a CRC behind what follows a colon."""
    return command.encode() + (f"{crc16(command.encode()):04X}".encode() if ":" in command else b"")


class Talk:
    """A system that sees `poses`, and the text of its answers."""

    def __init__(self, poses: Sequence[BodyPose] = (POSE, UNSEEN)) -> None:
        self.plugged = True
        self.poses = poses
        self.system = NdiSystem(lambda: self.poses, lambda: self.plugged)

    def raw(self, command: str) -> bytes:
        return self.system.answer(_line(command))

    def ask(self, command: str) -> str:
        """The answer without its CRC, which is checked."""
        answer = self.raw(command)
        assert answer.endswith(b"\r")
        assert answer[-5:-1] == f"{crc16(answer[:-5]):04X}".encode()
        return answer[:-5].decode()

    def load(self, srom: bytes) -> str:
        handle = self.ask("PHRQ:*********1****")
        for start in range(0, len(srom), 64):
            assert self.ask(f"PVWR:{handle}{start:04X}{srom[start : start + 64].ljust(64, bytes(1)).hex()}") == "OKAY"
        assert self.ask(f"PINIT:{handle}") == "OKAY"
        assert self.ask(f"PENA:{handle}D") == "OKAY"
        return handle

    def track(self, *bodies: str) -> None:
        assert self.ask("INIT:") == "OKAY"
        for body in bodies:
            self.load(placeholder(body))
        assert self.ask("TSTART:") == "OKAY"


@pytest.mark.parametrize(("text", "crc"), [(b"INIT:", 0xE3A5), (b"OKAY", 0xA896), (b"RESET", 0xBE6F)])
def test_the_crc_has_the_known_values(text: bytes, crc: int) -> None:
    assert crc16(text) == crc


@given(st.binary(max_size=64))
def test_the_crc_of_data_with_their_crc_is_zero(data: bytes) -> None:
    assert crc16(data + struct.pack("<H", crc16(data))) == 0


def test_the_bytes_of_a_session_in_text() -> None:
    talk = Talk()
    assert talk.system.answer(b"INIT:E3A5") == b"OKAYA896\r"
    assert talk.raw("PHRQ:*********1****") == reply("01")
    assert talk.load(placeholder("coil")) == "02"
    assert talk.load(placeholder("pointer")) == "03"
    assert talk.ask("PHSR:02") == "01" + "01001"
    assert talk.ask("PHSR:04") == "02" + "02031" + "03031"
    assert talk.ask("TSTART:") == "OKAY"
    coil = "02" + "+05000-05000+05000-05000" + "-003890+058617-123456" + "+01200"
    lines = ["01DISABLED" + "00000001" + "00000000", coil + "00000031" + "00000102"]
    lines += ["03MISSING" + "00000031" + "00000102"]
    assert talk.ask("TX:0001") == "03" + "\n".join(lines) + "\n" + "0000"
    assert talk.ask("TSTOP:") == "OKAY"
    assert talk.ask("RESET:0") == "RESET"
    assert talk.ask("PHRQ:*********1****") == "ERROR10"


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


def test_only_commands_with_a_colon_carry_a_crc() -> None:
    talk = Talk()
    assert talk.system.answer(b"INIT:E3A6") == reply("ERROR04")
    assert talk.system.answer(b"INIT:") == reply("ERROR04")
    assert talk.system.answer(b"INIT") == reply("OKAY")
    assert talk.system.answer(b"PHSR 00") == reply("00")


@pytest.mark.parametrize(
    ("prepare", "command", "error"),
    [
        ([], "TSTART:", "ERROR10"),
        ([], "TX:0001", "ERROR10"),
        ([], "GETINFO:Features", "ERROR01"),
        (["INIT:"], "TX:0001", "ERROR0C"),
        (["INIT:", "TSTART:"], "PHRQ:*********1****", "ERROR0C"),
        (["INIT:", "TSTART:"], "TX:1000", "ERROR23"),
        (["INIT:"], "PINIT:01", "ERROR2B"),
        (["INIT:"], "PINIT:1", "ERROR07"),
        (["INIT:", "PHRQ:*********1****"], "PINIT:01", "ERROR0D"),
        (["INIT:", "PHRQ:*********1****"], "PENA:01D", "ERROR0E"),
        (["INIT:", "PHRQ:*********1****"], "PENA:01X", "ERROR07"),
        (["INIT:", "PHRQ:*********1****"], "PVWR:010400" + "00" * 64, "ERROR23"),
        (["INIT:", "PHRQ:*********1****"], "PVWR:010000" + "0G" * 64, "ERROR07"),
        (["INIT:"] + ["PHRQ:*********1****"] * MOST_HANDLES, "PHRQ:*********1****", "ERROR2D"),
    ],
)
def test_command_in_a_wrong_state_has_its_error(prepare: list[str], command: str, error: str) -> None:
    talk = Talk()
    for each in prepare:
        assert not talk.ask(each).startswith("ERROR")
    assert talk.ask(command) == error


def test_unplugged_sensor_ends_tracking_and_cannot_initialize() -> None:
    talk = Talk()
    talk.track("coil")
    talk.plugged = False
    assert talk.ask("TX:0001") == "ERROR10"
    assert talk.ask("INIT:") == "ERROR15"
    talk.plugged = True
    assert talk.ask("INIT:") == "OKAY"


def test_a_foreign_tool_shows_the_next_body_that_none_shows() -> None:
    talk = Talk()
    talk.ask("INIT:")
    talk.load(placeholder("body_ref"))
    talk.load(b"NDI" + bytes(range(200)))
    talk.ask("TSTART:")
    assert "02+05000-05000" in talk.ask("TX:0001"), "coil is the first of all bodies"


@given(st.lists(st.tuples(commands, st.sampled_from([":", " ", ""]), parameters), max_size=30), st.booleans())
def test_every_command_is_answered_in_every_state(sent: list[tuple[str, str, str]], begun: bool) -> None:
    talk = Talk()
    if begun:
        talk.track(*BODIES)
    for name, sign, text in sent:
        answer = talk.raw(name + sign + text)
        if answer.startswith(b"\xc4\xa5"):
            (length,) = struct.unpack_from("<H", answer, 2)
            assert len(answer) == length + 8
            assert crc16(answer[6:]) == 0
        else:
            assert answer == reply(answer[:-5].decode())


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


async def test_replies_come_over_a_socket_however_the_commands_are_cut() -> None:
    async with running_cell({}, SystemClock()) as cell, serve_ndi(cell) as (host, port):
        reader, writer = await asyncio.open_connection(host, port)
        async with asyncio.timeout(10.0):
            writer.write(b"INIT:E3A5\rINI")
            assert await reader.readuntil(b"\r") == b"OKAYA896\r"
            writer.write(b"T:E3A5\rBEEP 1\r")
            assert await reader.readuntil(b"\r") == b"OKAYA896\r"
            assert await reader.readuntil(b"\r") == reply("1")
            writer.close()
            await writer.wait_closed()


async def test_a_tracker_that_is_as_if_absent_answers_nothing() -> None:
    async with running_cell({}, SystemClock()) as cell, serve_ndi(cell) as (host, port):
        inject(cell, "tracker_absent", {"on": True})
        reader, writer = await asyncio.open_connection(host, port)
        writer.write(b"INIT:E3A5\r")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.3):
                await reader.read(1)
        inject(cell, "tracker_absent", {"on": False})
        writer.write(b"BEEP 1\r")
        async with asyncio.timeout(10.0):
            assert await reader.readuntil(b"\r") == reply("1")
            writer.close()
            await writer.wait_closed()
