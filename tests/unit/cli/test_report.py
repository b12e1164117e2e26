"""`pcmrs report` writes a page and a PDF, whole or not at all, and never over a journal."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.unit.cli.command_line import run
from tests.unit.cli.journals import cut


def test_a_journal_becomes_a_page_and_the_same_facts_as_json(journal_path: Path, tmp_path: Path) -> None:
    output = tmp_path / "PAGE.HTML"
    ended = run("report", str(journal_path), "-o", str(output))
    assert ended.exit_code == 0, ended.stderr
    assert ended.stdout == f"The report of a patient not named is in {output}.\n"
    page = output.read_text(encoding="utf-8")
    assert "The robot, alas, is silent." in page
    facts = json.loads(run("report", str(journal_path), "-o", str(output), "--json").stdout)
    assert facts.get("problems", []) == []
    assert output.read_text(encoding="utf-8") == page, "the same session gives the same bytes"


def test_damage_is_named_and_reported_with_status_1(journal_path: Path, tmp_path: Path) -> None:
    cut(journal_path, 7)
    ended = run("report", str(journal_path), "-o", str(tmp_path / "a.html"))
    assert ended.exit_code == 1
    assert ended.stderr.startswith("not sound: ")
    assert (tmp_path / "a.html").is_file()


@pytest.mark.parametrize(("option", "ending"), [("-o", ".html"), ("--pdf", ".pdf")])
def test_a_mistyped_name_does_not_overwrite_a_journal(journal_path: Path, option: str, ending: str) -> None:
    before = journal_path.read_bytes()
    ended = run("report", str(journal_path), option, str(journal_path))
    assert ended.exit_code == 2
    assert f"does not end in {ending}" in ended.stderr
    assert journal_path.read_bytes() == before


def test_a_report_that_cannot_be_made_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "none.sqlite").write_bytes(b"no journal")
    ended = run("report", str(tmp_path / "none.sqlite"), "-o", str(tmp_path / "a.html"))
    assert ended.exit_code == 5
    assert [file.name for file in tmp_path.iterdir()] == ["none.sqlite"]
