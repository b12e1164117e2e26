"""The SQLite file: its guards, its synchronisation, and files that are no journal."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, verify
from pcmrs.journal.schema import HEADLESS, VERSION, WITHOUT_MAC, statements
from pcmrs.journal.writer import JournalWriter
from tests.unit.journal.edited_journal import GUARDS
from tests.unit.journal.journal_rows import intent, outcome, row


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE journal SET wall = 0 WHERE sequence = 1",
        "UPDATE journal SET body = x'00' WHERE sequence = 1",
        "UPDATE journal SET sequence = 9 WHERE sequence = 2",
        "DELETE FROM journal WHERE sequence = 2",
        "DELETE FROM journal",
        "INSERT INTO journal SELECT sequence + 5, kind, 's', 'i', '', 0, body, hash, hash, mac FROM journal LIMIT 1",
        "INSERT OR REPLACE INTO journal SELECT sequence, 'event', 's', 'i', '', 0, body, hash, hash, mac FROM journal",
    ],
)
async def test_rows_can_be_neither_changed_nor_removed(journal: Journal, path: Path, statement: str) -> None:
    await journal.append([intent("a"), outcome("a")])
    before = list(journal.reader.read())
    other = sqlite3.connect(path, isolation_level=None)
    with pytest.raises(sqlite3.IntegrityError):
        other.execute(statement)
    other.close()
    assert list(journal.reader.read()) == before


def test_a_missing_or_foreign_file_is_refused(path: Path) -> None:
    with pytest.raises(JournalError):
        JournalReader(path)
    foreign = sqlite3.connect(path)
    foreign.execute("CREATE TABLE somebody_elses (x)")
    foreign.close()
    before = path.read_bytes()
    with pytest.raises(JournalError, match="version 0"):
        Journal.open(path)
    assert path.read_bytes() == before
    with pytest.raises(JournalError, match="cannot be used"):
        Journal.open(path.parent / "no such folder" / "journal.sqlite")


@pytest.mark.parametrize("query", ["FROM kept", "FROM kept UNION ALL SELECT * FROM kept"])
async def test_rows_that_a_query_makes_are_no_journal(path: Path, query: str) -> None:
    """A view can make rows without end; nothing is asked of one."""
    journal = Journal.open(path)
    await journal.append([row()])
    await journal.close()
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("ALTER TABLE journal RENAME TO kept")
        connection.execute(f"CREATE VIEW journal AS SELECT * {query}")
        connection.commit()
    with pytest.raises(JournalError, match="another file"):
        JournalReader(path)


@pytest.mark.parametrize(("durable", "level"), [(True, 2), (False, 0)])
def test_durable_means_full_synchronisation(path: Path, durable: bool, level: int) -> None:
    writer = JournalWriter(path, durable=durable)
    assert writer._connection.execute("PRAGMA synchronous").fetchone() == (level,)
    assert writer._connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    writer.close()


@pytest.mark.parametrize("guard", GUARDS)
def test_missing_guard_is_reported_although_all_rows_are_sound(whole_path: Path, guard: str) -> None:
    with closing(sqlite3.connect(whole_path)) as connection:
        connection.execute(f"DROP TRIGGER {guard}")
    with pytest.raises(JournalError, match=f"was changed: {guard} differs from"):
        Journal.open(whole_path)
    found = verify(whole_path)
    assert (found.first_bad, found.rows, found.sound) == (None, 18, False)
    (problem,) = found.problems
    assert guard in problem


@pytest.mark.parametrize(("pragma", "instead"), [("synchronous", "1"), ("journal_mode", "DELETE")])
def test_a_disk_that_cannot_be_waited_for_is_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch, pragma: str, instead: str
) -> None:
    """Some network file systems know no such log, and builds of SQLite may be set otherwise."""

    class Deaf(sqlite3.Connection):
        def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
            return super().execute(
                f"PRAGMA {pragma} = {instead}" if sql.startswith(f"PRAGMA {pragma} =") else sql, *values
            )

    JournalWriter(path, durable=True).close()
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *where, **how: connect(*where, factory=Deaf, **how))
    with pytest.raises(JournalError, match="cannot be written safely"):
        JournalWriter(path, durable=True)


def test_an_upgraded_file_is_made_as_a_new_one() -> None:
    """Otherwise its schema would be refused."""
    assert statements(HEADLESS) == statements(WITHOUT_MAC)
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.execute(statements(WITHOUT_MAC)["journal"])
        connection.execute("ALTER TABLE journal ADD COLUMN mac BLOB")
        (made,) = connection.execute("SELECT sql FROM sqlite_schema WHERE name = 'journal'").fetchone()
    assert made == statements(VERSION)["journal"]
