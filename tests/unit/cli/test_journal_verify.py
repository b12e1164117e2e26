"""`pcmrs journal verify`: a whole journal is proven, and missing rows are counted."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

from tests.unit.cli.journals import journal_command


def test_a_whole_journal_is_proven(journal_path: Path) -> None:
    shown = journal_command("verify", journal_path)
    assert shown.exit_code == 0
    assert "12 rows are proven" in shown.stdout
    report = json.loads(journal_command("verify", journal_path, "--json").stdout)
    assert (report["rows"], report["signed"], report["signature"], report["problems"]) == (12, 12, "holds", [])


def test_rows_that_are_missing_are_counted(journal_path: Path) -> None:
    with sqlite3.connect(journal_path) as connection:
        (guard,) = connection.execute("SELECT sql FROM sqlite_schema WHERE name = 'no_delete'").fetchone()
        connection.execute("DROP TRIGGER no_delete")
        connection.execute("DELETE FROM journal WHERE sequence > 7")
        connection.execute(guard)
    connection.close()
    shown = journal_command("verify", journal_path)
    assert shown.exit_code == 1
    assert "5 rows that the head names" in shown.stdout
