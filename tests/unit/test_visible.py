"""Text from outside acts on no terminal and begins no line of the log."""

from __future__ import annotations

import io
import json
import logging
import os
from pathlib import Path

import pytest
import structlog
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.cli.cell import event_line
from pcmrs.cli.log import log_to_stderr
from pcmrs.cli.printing import say
from pcmrs.cli.tables import Terminal
from pcmrs.messages import DeviceEvent
from pcmrs.visible import visible

CLEAR = "\x1b[2J\x1b[1;31m"
FORGED = f"lost{CLEAR}\n2026-01-01 [info     ] robot released\u202e\x9b2K"
"""It clears the screen, forges a line of the log, and turns the writing direction round."""


@given(st.text())
def test_every_character_can_be_printed_and_none_is_lost(text: str) -> None:
    shown = visible(text)
    assert shown.isprintable()
    quoted = visible(json.dumps(text, ensure_ascii=False))
    assert quoted.isprintable()
    assert json.loads(quoted) == text


@given(st.recursive(st.text() | st.integers(), lambda values: st.lists(values) | st.dictionaries(st.text(), values)))
def test_json_stays_the_same_json(value: object) -> None:
    assert json.loads(visible(json.dumps(value, ensure_ascii=False))) == value


def test_printable_text_stays_as_it_is() -> None:
    assert visible("Größe 3 µm, 90°, 東京") == "Größe 3 µm, 90°, 東京"


def test_printed_text_controls_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    say(event_line(DeviceEvent(device="tracker\x1b]0;", code="lost", text=FORGED)))
    written = capsys.readouterr().out
    assert written.endswith("\n")
    assert written[:-1].isprintable()
    table = io.StringIO()
    Terminal(file=table, width=200).print(FORGED)
    assert all(line.isprintable() for line in table.getvalue().splitlines())


def _fail() -> None:
    raise ValueError(FORGED)


def test_logged_text_starts_no_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "log"
    descriptor = os.open(file, os.O_WRONLY | os.O_CREAT)
    monkeypatch.setattr("pcmrs.cli.log.STANDARD_ERROR", descriptor)
    root = logging.getLogger()
    before, handlers = structlog.get_config(), root.handlers
    root.handlers = []
    try:
        stream = log_to_stderr()
        structlog.get_logger().warning("ignored", key=FORGED, **{f"field{CLEAR}": 1})
        logging.getLogger("pcmrs").warning("Ignored a message on %s", FORGED)
        try:
            _fail()
        except ValueError:
            structlog.get_logger().exception("failed")
            logging.getLogger("pcmrs").exception("failed")
        stream.close()
    finally:
        root.handlers = handlers
        structlog.configure(**before)
        os.close(descriptor)
    lines = file.read_text().splitlines()
    assert all(line.isprintable() for line in lines)
    assert not [line for line in lines if line.startswith("2026-01-01")]
    assert sum("released" in line for line in lines) >= 4
