"""Rows of text from outside: what a log must not show, and which token opens no console."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs.visible import visible
from pcmrs_lab.campaign.fault import Evidence
from pcmrs_lab.campaign.faults import outside_text
from pcmrs_lab.campaign.faults.outside_text import FORGED, MARK
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started

ESCAPED = f"warning malformed field={MARK}\\u001b[2J\\n2026-01-01 [info     ] robot released\\u202e\n"
PLAIN = f"warning malformed field={MARK}-plain\n"


def logging(monkeypatch: pytest.MonkeyPatch, cell: OperatedCell, lines: dict[str, str]) -> None:
    """A daemon that logs these lines for the names of fields; one without guards logs each name as it came."""

    def put(to: Any, user: str, name: str) -> None:
        known = lines if to is cell else {}
        to.log += known.get(name, f"warning malformed field={name}\n")

    monkeypatch.setattr(outside_text, "_put", put)


SNAPSHOT = b"#7 registration=100\n"
REJECTED = "rejected: registration.reinit: bad_arguments: unknown field `" + visible(FORGED) + "`\n"


def printing(monkeypatch: pytest.MonkeyPatch, watched: str, journal: str = REJECTED, state: str = "latched\n") -> None:
    """Commands that print this after a command with that argument was rejected."""
    started(monkeypatch, ScriptedChild(SNAPSHOT + watched.encode()))

    async def ended(words: list[str]) -> tuple[int, str]:
        return 0, journal if "journal" in words else state

    monkeypatch.setattr(outside_text, "ended", ended)


def escaped(
    monkeypatch: pytest.MonkeyPatch, folder: Path, lines: dict[str, str], watched: str = REJECTED, **printed: str
) -> Evidence:
    cell = OperatedCell()
    logging(monkeypatch, cell, lines)
    printing(monkeypatch, watched, **printed)
    return run(monkeypatch, outside_text.escape_sequences(lab_of(folder, cell)))


def test_a_name_is_logged_without_any_effect(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = escaped(monkeypatch, tmp_path, {FORGED: ESCAPED})
    assert proves(found)
    assert found.took_place == {"escapes in the log": 1, "escapes that are printed": 2}
    assert found.control == {
        "raw escapes in the log without the guard": 1,
        "times a plain name is logged as it is": 1,
    }


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        ({FORGED: f"field={FORGED}\n"}, "The log has"),
        ({FORGED: f"field={MARK}u001b\n2026-01-01 [info     ] robot released\n"}, "A line of the log is forged"),
        ({FORGED: f"field={MARK}\n"}, "The name did not arrive"),
        ({FORGED: ESCAPED, f"{MARK}-plain": f"field={MARK}\n"}, "A plain name is not logged unchanged"),
    ],
)
def test_anything_else_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, lines: dict[str, str], text: str
) -> None:
    with pytest.raises(Unmet, match=text):
        escaped(monkeypatch, tmp_path, lines)


@pytest.mark.parametrize(
    ("printed", "text"),
    [
        ({"watched": f"rejected: {FORGED}\n"}, "watch has printed"),
        ({"watched": f"rejected: {MARK}\n"}, "watch did not show the name"),
        ({"watched": "rejected\n"}, f"pcmrs watch did not show {MARK}"),
        ({"journal": f"rejected: {FORGED}\n"}, "journal has printed"),
        ({"journal": f"rejected: {MARK} u001b\n2026-01-01 released\n"}, "journal has printed a forged line"),
        ({"journal": "rejected\n"}, "journal did not show the name"),
        ({"state": "\x1b[2J"}, "state has printed"),
    ],
)
def test_a_command_that_prints_the_name_as_it_is_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, printed: dict[str, str], text: str
) -> None:
    with pytest.raises(Unmet, match=text):
        escaped(monkeypatch, tmp_path, {FORGED: ESCAPED}, **printed)


def test_a_harmless_name_is_found_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with sham(), pytest.raises(Unmet, match="The name did not arrive"):
        escaped(monkeypatch, tmp_path, {FORGED: ESCAPED})


@pytest.mark.parametrize("log", ["", f"half a line of {MARK}"])
def test_a_name_that_is_not_logged_is_unmet(monkeypatch: pytest.MonkeyPatch, log: str) -> None:
    cell = OperatedCell()
    cell.log = f"before {MARK}\n" + log
    with pytest.raises(Unmet, match="did not log the name"):
        run(monkeypatch, outside_text._logged(cell.as_cell, len(f"before {MARK}\n")))


def test_a_token_is_a_secret_file(tmp_path: Path) -> None:
    file = outside_text._token(tmp_path, "x" * 20)
    assert file.read_text() == "x" * 20
    assert file.stat().st_mode & 0o777 == 0o600


REFUSED, SERVES = b"A log line\nError: the minimum is 20.\n", b'starting\n{"url": "http://127.0.0.1"}\n'


def opened(monkeypatch: pytest.MonkeyPatch, folder: Path, *outputs: bytes) -> Evidence:
    children = [ScriptedChild(output) for output in outputs]
    for child in children:
        child.returncode = None if b'"url"' in child._output else 4
    started(monkeypatch, *children)
    return run(monkeypatch, outside_text.guessable_token(lab_of(folder, OperatedCell())))


def test_a_guessable_token_opens_no_console(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = opened(monkeypatch, tmp_path, REFUSED, REFUSED, SERVES)
    assert proves(found)
    assert len(found.took_place["said of the token"]) == 2
    assert found.control == {"20 characters open one": True}


@pytest.mark.parametrize(
    ("outputs", "text"),
    [
        ((SERVES,), r"With '' it ended with -15"),
        ((b"Error: the port is in use.\n",), r"With '' it ended with 4: Error: the port"),
        ((REFUSED, REFUSED, b"Error: the port is in use.\n"), "With a good token it printed"),
        ((REFUSED, REFUSED, b""), "With a good token it printed ''"),
    ],
)
def test_a_console_that_opens_or_ends_otherwise_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, outputs: tuple[bytes, ...], text: str
) -> None:
    with pytest.raises(Unmet, match=text):
        opened(monkeypatch, tmp_path, *outputs)
