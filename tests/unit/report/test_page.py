"""The page of a report: no script, nothing from outside, and first what matters most."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.unit.report.report_journals import Row, altered, golden_rows, write_journal
from tests.unit.report.report_page import page_of

NASTY = "<script>alert('$x_{')</script> & \"Zoë\" 患者 http://example.org"


def test_page_runs_and_loads_nothing_and_journal_text_is_text(tmp_path: Path) -> None:
    def poison(row: Row) -> None:
        result = row.get("result") or {}
        if row["kind"] == "config":
            result["settings"]["procedure"] |= {"patient": NASTY, "operator": NASTY}
        if row.get("user"):
            row["user"] = NASTY
        for kept in (result.get("registered"), result):
            for landmark in (kept or {}).get("landmarks", []):
                landmark["name"] = f"{landmark['name']} {NASTY}"
        if row.get("verdict") and row["verdict"]["reason"]:
            row["verdict"]["reason"]["text"] = NASTY
        if row["kind"] == "device":
            result["text"] = row["operation"] = NASTY

    journal = write_journal(altered(golden_rows("ratms"), poison), tmp_path / "j.sqlite")
    page = page_of(journal, "--pdf", tmp_path / "page.pdf")
    assert not page.names & {"script", "link", "iframe", "object", "form", "base", "svg"}
    for attribute, value in page.attributes:
        assert not attribute.startswith("on")
        if attribute in ("src", "href"):
            assert value.startswith("data:image/svg+xml;base64,")
    source = (tmp_path / "page.html").read_text()
    assert not re.search(r"url\(|@import", source)
    assert page.value("Patient") == page.value("Operator") == NASTY
    assert page.words.count(NASTY) > 20
    assert (tmp_path / "page.pdf").stat().st_size > 20_000


@pytest.mark.usefixtures("without_figures")
def test_first_page_shows_unfinished_commands_and_open_stops(tmp_path: Path) -> None:
    rows = golden_rows("ratms")
    begun = next(number for number, row in enumerate(rows) if (row["kind"], row["operation"]) == ("intent", "confirm"))
    page = page_of(write_journal(rows[: begun + 1], tmp_path / "begun" / "j.sqlite"))
    assert "confirm (placement): It was in progress when the session ended unexpectedly." in page.words
    stopped = next(number for number, row in enumerate(rows) if row["operation"] == "stopped")
    page = page_of(write_journal(rows[: stopped + 1], tmp_path / "stopped" / "j.sqlite"))
    if "is not installed here" not in page.value("Workflow"):  # only the very workflow says what acknowledges
        assert "At the end a Stop or fault had not been acknowledged." in page.words
