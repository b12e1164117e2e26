"""Verification reports what is lost or bad, with the first row."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, verify
from tests.unit.journal.edited_journal import alter, make_index
from tests.unit.journal.whole_journal import LOG


def test_index_with_too_many_rows_is_detected_by_verify(whole_path: Path) -> None:
    make_index(whole_path, "one_intent", "OR kind = 'event'")
    found = verify(whole_path)
    assert (found.first_bad, found.rows) == (None, 18)
    assert any("The database is damaged" in problem for problem in found.problems)


def test_lost_log_is_reported_with_the_number_of_rows(killed_path: Path) -> None:
    killed_path.with_name(LOG).unlink()
    with pytest.raises(JournalError, match=r"18 acknowledged rows are lost.*--good-part") as told:
        Journal.open(killed_path)
    assert told.value.fields["missing"] == 18
    assert verify(killed_path).missing == 18


@pytest.mark.parametrize(
    ("statement", "word"),
    [
        ("UPDATE journal SET body = CAST(replace(body, 'c3', 'x3') AS BLOB) WHERE sequence = 10", "row 10"),
        ("UPDATE journal SET kind = 'event' WHERE sequence = 11", "row 11"),
        ("UPDATE journal SET command_id = 'else' WHERE sequence = 10", "row 10"),
        ("DELETE FROM journal WHERE sequence = 7", "row 7 is missing"),
    ],
)
def test_edited_journal_is_reported_with_the_first_bad_row(killed_path: Path, statement: str, word: str) -> None:
    guards = [f"DROP TRIGGER {name}" for name in ("no_update", "no_delete")]
    with JournalReader(killed_path) as reader:
        select = "SELECT sql FROM sqlite_schema WHERE name IN ('no_update', 'no_delete')"
        again = [sql for (sql,) in reader._files[-1][1].execute(select)]
    alter(killed_path, *guards, statement)
    with pytest.raises(JournalError, match="no_delete, no_update"):
        Journal.open(killed_path)
    alter(killed_path, *again)  # who does it well puts the guards back
    with pytest.raises(JournalError, match=word):
        Journal.open(killed_path)
    found = verify(killed_path)
    assert not found.sound
    assert f"row {found.first_bad}" in word
    assert found.rows == (found.first_bad or 0) - 1
