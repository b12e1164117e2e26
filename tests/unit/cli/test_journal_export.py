"""`pcmrs journal export`: tables for other programs, and the good part of a damaged journal."""

from __future__ import annotations

import csv
import json
from pathlib import Path

from tests.unit.cli.journals import damage, journal_command, rows_of


def test_a_table_holds_what_the_rows_hold(journal_path: Path, tmp_path: Path) -> None:
    exported = tmp_path / "rows.csv"
    assert journal_command("export", journal_path, "-o", exported).exit_code == 0
    with exported.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["sequence"]) for row in rows] == list(range(1, 13))
    assert json.loads(rows[0]["arguments"]) == rows_of(0)[0].arguments
    assert rows[1]["decision"] == "failed"
    assert rows[1]["reason"] == "silent"
    assert rows[1]["time"] == "2023-11-14T22:13:20.000+00:00"
    assert rows[2]["command_id"] == ""


def test_the_first_bad_row_is_named_and_the_good_part_is_saved(journal_path: Path, tmp_path: Path) -> None:
    damage(journal_path, 8)
    shown = journal_command("verify", journal_path, "--json")
    assert shown.exit_code == 1
    assert json.loads(shown.stdout)["first_bad"] == 8
    exported = tmp_path / "rows.jsonl"
    refused = journal_command("export", journal_path, "-o", exported)
    assert refused.exit_code == 5
    assert "row 8" in refused.stderr
    assert list(tmp_path.glob("rows*")) == []
    saved = journal_command("export", journal_path, "-o", exported, "--good-part")
    assert saved.exit_code == 1
    assert [json.loads(line)["sequence"] for line in exported.read_text().splitlines()] == list(range(1, 8))
    assert "row 8" in saved.stderr


def test_missing_journal_or_unknown_format_is_not_damage(journal_path: Path, tmp_path: Path) -> None:
    assert journal_command("verify", tmp_path / "none.sqlite").exit_code == 5
    wrong = journal_command("export", journal_path, "-o", tmp_path / "rows.txt")
    assert wrong.exit_code == 2
    assert ".jsonl or .csv" in wrong.stderr
