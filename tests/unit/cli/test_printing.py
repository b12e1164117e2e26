"""Lines: text from outside can neither control the terminal nor forge a line."""

from __future__ import annotations

import json

import msgspec
import pytest

from pcmrs.cli.printing import say, say_json

NASTY = "\x1b[2Jall is well\r\x07\u202e\nforged"


class Report(msgspec.Struct):
    name: str
    value: float | None = None


def test_a_line_stays_one_line_and_sends_no_control_character(capsys: pytest.CaptureFixture[str]) -> None:
    say(NASTY)
    say(NASTY, err=True)
    for text in capsys.readouterr():
        assert text.endswith("\n")
        assert text[:-1].isprintable()
        assert "all is well" in text


def test_json_keeps_every_value_although_it_is_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    say_json(Report(NASTY, 0.1))
    out = capsys.readouterr().out
    assert out[:-1].isprintable()
    assert json.loads(out) == {"name": NASTY, "value": 0.1}
