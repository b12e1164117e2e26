"""`pcmrs journal verify`: a whole journal is proven, and missing rows are counted."""

from __future__ import annotations

import json
from pathlib import Path

from tests.unit.cli.journals import cut, journal_command


def test_a_whole_journal_is_proven(journal_path: Path) -> None:
    shown = journal_command("verify", journal_path)
    assert shown.exit_code == 0
    assert "12 rows are proven" in shown.stdout
    report = json.loads(journal_command("verify", journal_path, "--json").stdout)
    assert (report["rows"], report["signed"], report["signature"], report["problems"]) == (12, 12, "holds", [])


def test_rows_that_are_missing_are_counted(journal_path: Path) -> None:
    cut(journal_path, 7)
    shown = journal_command("verify", journal_path)
    assert shown.exit_code == 1
    assert "5 rows that the head names" in shown.stdout
