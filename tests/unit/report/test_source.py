"""A damaged journal is reported as far as it is good; without a good row there is no report."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from tests.unit.report.damage import turn_bit
from tests.unit.report.report_journals import golden_rows, write_journal
from tests.unit.report.report_page import page_of, run

pytestmark = pytest.mark.usefixtures("without_figures")


def cut(journal: Path) -> None:
    with closing(sqlite3.connect(journal)) as database:
        (guard,) = database.execute("SELECT sql FROM sqlite_schema WHERE name = 'no_delete'").fetchone()
        database.execute("DROP TRIGGER no_delete")
        database.execute("DELETE FROM journal WHERE sequence > 125")
        database.execute(guard)
        database.commit()


def forget_key(journal: Path) -> None:
    (journal.parent / "journal.pub").unlink()


@pytest.mark.parametrize(
    ("damage", "rows", "said"),
    [
        (cut, 125, "10 acknowledged rows are lost"),
        (lambda journal: turn_bit(journal, 60), 59, "row 60"),
        (forget_key, 135, "journal.pub is not the public key"),
    ],
    ids=["rows cut off", "a bit", "no key"],
)
def test_damaged_journal_is_reported_as_far_as_it_is_good(damage: Any, rows: int, said: str, tmp_path: Path) -> None:
    """The page says first that it is not complete."""
    journal = write_journal(golden_rows("ratms"), tmp_path / "j.sqlite")
    damage(journal)
    before = journal.read_bytes()
    page = page_of(journal, status=1)
    assert page.words.index("The journal is damaged: this report is not complete.") < page.words.index("Placements")
    assert said in page.words
    assert f"the {rows} rows from the first on" in page.words
    assert page.value("Journal").startswith("damaged or not proven")
    assert str(tmp_path) not in page.words
    assert journal.read_bytes() == before


def test_unreadable_source_is_an_error_and_nothing_is_written(tmp_path: Path) -> None:
    journal = write_journal(golden_rows("ratms")[:20], tmp_path / "cell" / "j.sqlite")
    turn_bit(journal, 1)
    text, empty, two = tmp_path / "text", tmp_path / "empty", tmp_path / "two"
    text.write_text("no journal")
    empty.mkdir()
    for number in range(2):
        write_journal(golden_rows("ratms")[:2], two / f"{number}.sqlite")
    for source, said in ((journal, "row 1"), (text, "text"), (empty, "no journal"), (two, "name one")):
        status, out, err = run(source, "-o", tmp_path / "page.html")
        assert (status, out, len(err.splitlines())) == (5, "", 1), err
        assert said in err
    assert not (tmp_path / "page.html").exists()
