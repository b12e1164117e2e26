"""The shipped questions, on journals of two cells and on a recorded one."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.archive import QUESTIONS, ArchiveStore, add_journal
from pcmrs.journal import JournalRow
from pcmrs.messages import Verdict
from tests.unit.archive.archives import answer, config, failed, write
from tests.unit.journal.journal_rows import row
from tests.unit.report.report_journals import golden_rows, write_journal


def asked(store: ArchiveStore, name: str) -> list[dict[str, Any]]:
    return answer(store, QUESTIONS[name].sql)


def accepted(command_id: str, name: str, result: dict[str, Any]) -> JournalRow:
    branch, operation = name.split(".")
    names: dict[str, Any] = {"branch": branch, "operation": operation}
    verdict = Verdict(id=command_id, decision="accepted", state="1", sequence=1, result=result, **names)
    return row("outcome", command_id=command_id, source="bus:local", verdict=verdict, **names)


def placement(command_id: str, mm: float) -> JournalRow:
    result = {"translation_error": mm / 1e3, "rotation_error": 0.0}
    return accepted(command_id, "placement.confirm", result)


def event(source: str, code: str, *, danger: bool = True) -> JournalRow:
    result = {"text": f"{code} by {source}.", "danger": danger, "fields": {}}
    return row("device", source=source, operation=code, result=result)


def session(site: str, tool: str, *rows: JournalRow) -> list[JournalRow]:
    connected = accepted("connect", "robot.connect", {"calibration": {"tool": tool, "pointer": "explicit"}})
    return [msgspec.structs.replace(each, session_id=tool) for each in (config(site), connected, *rows)]


@pytest.fixture
def filled(store: ArchiveStore, tmp_path: Path) -> ArchiveStore:
    """Two cells with two tools, and Stops of persons and devices."""
    rows = session(
        "lab",
        "coil A",
        placement("p1", 1.0),
        placement("p2", 3.0),
        event("bus:anna", "stopped"),
        failed("approach", "stopped"),
        failed("nudge", "silent"),
        event("bus:anna", "stop_pressed_again", danger=False),
        event("device:robot", "drives_off"),
        event("daemon", "hold_not_confirmed"),
        event("shutdown", "stopped"),
    )
    add_journal(store, write(tmp_path / "lab" / "ratms.sqlite", rows))
    oslo = session("oslo", "coil B", placement("p1", 5.0), failed("approach", "stopped"))
    add_journal(store, write(tmp_path / "oslo" / "ratms.sqlite", oslo))
    return store


def test_who_stopped_what(filled: ArchiveStore) -> None:
    found = [(each["who"], each["why"], each["what"], each["site"]) for each in asked(filled, "stops")]
    assert found == [
        ("bus:anna", "stopped", "robot.approach", "lab"),
        ("device:robot", "drives_off", None, "lab"),
    ]


def test_errors_by_tool(filled: ArchiveStore) -> None:
    found = asked(filled, "errors-by-tool")
    assert [(each["tool"], each["placements"], each["max_mm"]) for each in found] == [
        ("coil A", 2, pytest.approx(3.0)),
        ("coil B", 1, pytest.approx(5.0)),
    ]
    assert found[0]["mean_mm"] == pytest.approx(2.0)
    assert found[0]["sd_mm"] == pytest.approx(2.0**0.5)


def test_errors_by_site(filled: ArchiveStore) -> None:
    found = asked(filled, "errors-by-site")
    assert [(each["site"], each["placements"]) for each in found] == [("lab", 2), ("oslo", 1)]


def test_decisions_and_sessions(filled: ArchiveStore) -> None:
    decisions = {
        (each["site"], each["operation"], each["reason"]): each["commands"] for each in asked(filled, "decisions")
    }
    assert decisions["lab", "confirm", None] == 2
    assert decisions["lab", "approach", "silent"] == 1
    sessions = asked(filled, "sessions")
    assert [(each["site"], each["session_id"], each["rows"]) for each in sessions] == [
        ("lab", "coil A", 11),
        ("oslo", "coil B", 4),
    ]
    assert sessions[0]["began"] == datetime.datetime(2023, 11, 14, 22, 13, 20)


def test_a_recorded_journal_is_asked(store: ArchiveStore, tmp_path: Path) -> None:
    path = write_journal(golden_rows("ratms"), tmp_path / "cell" / "ratms.sqlite")
    add_journal(store, path)
    stops = asked(store, "stops")
    assert [each["sequence"] for each in stops] == [13, 63, 73]
    assert [each["what"] for each in stops if each["what"]] == [
        "digitization.digitize_all",
        "placement.home",
        "placement.approach",
    ]
    (errors,) = asked(store, "errors-by-site")
    assert errors["placements"] == 1
