"""Commands to the virtual tracker, and the errors in its answers."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.ndi.tools import placeholder
from pcmrs_sim.ndi.protocol import crc16, reply
from pcmrs_sim.ndi.system import MOST_HANDLES
from pcmrs_sim.tracker_faults import BODIES
from tests.unit.sim.ndi.ndi_talk import Talk

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


def test_the_bytes_of_a_session_in_text() -> None:
    talk = Talk()
    assert talk.system.answer(b"INIT:E3A5") == b"OKAYA896\r"
    assert talk.raw("PHRQ:*********1****") == reply("01")
    assert talk.load(placeholder("coil")) == "02"
    assert talk.load(placeholder("pointer")) == "03"
    assert talk.ask("PHSR:01") == "01" + "01000"
    assert talk.ask("PHSR:02") == "00"
    assert talk.ask("PHSR:04") == "02" + "02031" + "03031"
    assert talk.ask("TSTART:") == "OKAY"
    coil = "02" + "+05000-05000+05000-05000" + "-003890+058617-123456" + "+01200"
    lines = ["01DISABLED" + "00000000" + "00000000", coil + "00000031" + "00000102"]
    lines += ["03MISSING" + "00000031" + "00000102"]
    assert talk.ask("TX:0001") == "03" + "\n".join(lines) + "\n" + "0000"
    assert talk.ask("TSTOP:") == "OKAY"
    assert talk.ask("RESET:0") == "RESET"
    assert talk.ask("PHRQ:*********1****") == "ERROR10"


def test_a_client_that_frees_no_handles_can_connect_again() -> None:
    """The bytes of scikit-surgerynditracker with three tools; it leaves its handles to the next INIT."""
    talk = Talk()
    for _ in range(3):
        assert talk.system.answer(b"INIT:E3A5") == b"OKAYA896\r"
        assert talk.ask("PHSR:01") == "00"
        for number in (1, 2, 3):
            assert talk.ask("PHRQ:*********1****") == f"{number:02X}"
            assert talk.ask(f"PVWR:{number:02X}0000" + f"{number:02x}" * 64) == "OKAY"
        assert talk.ask("PHSR:01") == "00"
        assert talk.ask("PHSR:02") == "03" + "01001" + "02001" + "03001"
        assert [talk.ask(f"PINIT:{number:02x}") for number in (1, 2, 3)] == ["OKAY"] * 3
        assert talk.ask("PHSR:02") == "00"
        assert talk.ask("PHSR:03") == "03" + "01011" + "02011" + "03011"
        assert [talk.ask(f"PENA:{number:02x}D") for number in (1, 2, 3)] == ["OKAY"] * 3
        assert talk.ask("PHSR:03") == "00"
        assert talk.ask("PHSR:04") == talk.ask("PHSR:00") == "03" + "01031" + "02031" + "03031"
        assert talk.ask("TSTART:") == "OKAY"
        assert talk.raw("BX:0801")[6] == 3
        assert talk.ask("TSTOP:") == "OKAY"


def test_a_handle_without_a_tool_is_one_to_be_freed() -> None:
    talk = Talk()
    talk.ask("INIT:")
    assert talk.ask("PHRQ:*********1****") == "01"
    talk.load(placeholder("coil"))
    assert talk.ask("PHSR:01") == "01" + "01000"
    assert talk.ask("PHF:01") == "OKAY"
    assert talk.ask("PHSR:01") == "00"
    assert talk.ask("PHSR:00") == "01" + "02031"


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
