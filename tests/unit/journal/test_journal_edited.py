"""A journal that was edited by somebody who knows its format: the first bad row is told."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, Kind, verify
from pcmrs.journal.chain import stored_row
from pcmrs.journal.rows import chain_hash, encode_row
from pcmrs.journal.writer import JournalWriter
from pcmrs.testing.journal import HEAD, place
from tests.unit.journal.journal_rows import row
from tests.unit.journal.whole_journal import sample

GUARDS = ("no_update", "no_delete", "no_gap")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "whole").mkdir()
    return place(sample(tmp_path / "whole", killed=False).files, tmp_path / "cell")


def edit(path: Path, statement: str, values: tuple[Any, ...] = ()) -> None:
    """Puts the guards back afterwards."""
    connection = sqlite3.connect(path)
    with connection:
        guards = dict(connection.execute("SELECT name, sql FROM sqlite_schema WHERE type = 'trigger'"))
        for name in GUARDS:
            connection.execute(f"DROP TRIGGER {name}")
        connection.execute(statement, values)
        for name in GUARDS:
            connection.execute(guards[name])
    connection.close()


def check_told(path: Path, sequence: int, word: str) -> None:
    with pytest.raises(JournalError, match=f"row {sequence} {word}"):
        Journal.open(path)
    found = verify(path)
    assert (found.first_bad, found.rows, found.sound) == (sequence, sequence - 1, False)


def test_row_replaced_with_its_own_hash_breaks_the_chain(path: Path) -> None:
    with JournalReader(path) as reader:
        rows = list(reader.read())
    ninth = rows[8]
    assert (ninth.sequence, ninth.row.kind) == (9, "event")
    body = encode_row(rows[5].row)  # the event of another command: right in itself, at the wrong place
    own = chain_hash(ninth.previous_hash, 9, body)
    edit(path, "UPDATE journal SET body = ?, hash = ? WHERE sequence = 9", (body, own))
    check_told(path, 10, "does not follow")


def replace_from(path: Path, sequence: int, body: bytes) -> None:
    """Another row, and all that follow chained to it: right in themselves."""
    with JournalReader(path) as reader:
        rows = list(reader.read(after=sequence - 1))
    previous = rows[0].previous_hash
    for stored in rows:
        new = body if stored.sequence == sequence else encode_row(stored.row)
        own = chain_hash(previous, stored.sequence, new)
        statement = "UPDATE journal SET body = ?, previous_hash = ?, hash = ? WHERE sequence = ?"
        edit(path, statement, (new, previous, own, stored.sequence))
        previous = own


def test_replaced_last_row_is_not_the_one_named_by_the_head(path: Path) -> None:
    replace_from(path, 15, encode_row(row(result={"number": -1})))
    with pytest.raises(JournalError, match="another row 18 than the one that its signed head names"):
        Journal.open(path)
    found = verify(path)
    assert (found.sound, found.rows, found.signed) == (False, 18, 0)


def test_snapshot_after_the_row_named_by_the_head_hides_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = JournalWriter(path, durable=False)
    monkeypatch.setattr(writer._head, "write", lambda place: None)
    for kind in ("event", "snapshot", "event"):
        writer.write([(row(kind), encode_row(row(kind)))])
    writer.close()
    replace_from(path, 18, encode_row(row(result={"number": -1})))
    with pytest.raises(JournalError, match="another row 18"):
        Journal.open(path)


@pytest.mark.parametrize("kind", ["snapshot", "config"])
def test_a_journal_that_calls_itself_older_still_needs_its_head(path: Path, kind: Kind) -> None:
    writer = JournalWriter(path, durable=False)
    writer.write([(row(kind), encode_row(row(kind)))])
    writer.close()
    edit(path, "ALTER TABLE journal DROP COLUMN mac")
    edit(path, "PRAGMA user_version = 1")
    path.with_name(HEAD).unlink()
    with pytest.raises(JournalError, match="holds rows of a later one"):
        Journal.open(path)
    assert not path.with_name(HEAD).exists()


@pytest.mark.parametrize("change", ["branch = 'placement'", "wall = 0.0", "source = 'else'"])
@pytest.mark.parametrize("sequence", [9, 10])
def test_row_entered_under_other_keys_is_detected(path: Path, change: str, sequence: int) -> None:
    edit(path, f"UPDATE journal SET {change} WHERE sequence = {sequence}")
    check_told(path, sequence, "is stored under wrong keys")


def make_index(path: Path, name: str, condition: str) -> None:
    """Makes an index of other rows than its definition says."""
    connection = sqlite3.connect(path, isolation_level=None)
    (sql,) = connection.execute("SELECT sql FROM sqlite_schema WHERE name = ?", (name,)).fetchone()
    connection.execute(f"DROP INDEX {name}")
    connection.execute(f"{sql} {condition}")
    connection.execute("PRAGMA writable_schema = ON")
    connection.execute("UPDATE sqlite_schema SET sql = ? WHERE name = ?", (sql, name))
    connection.close()


@pytest.mark.parametrize(("kind", "sequence"), [("intent", 7), ("outcome", 8)])
def test_row_missing_in_its_index_is_detected(path: Path, kind: str, sequence: int) -> None:
    """A repeat of its command would run a second time."""
    make_index(path, f"one_{kind}", f"AND sequence <> {sequence}")
    check_told(path, sequence, "is not found by its command")


def test_index_with_too_many_rows_is_detected_by_verify(path: Path) -> None:
    make_index(path, "one_intent", "OR kind = 'event'")
    found = verify(path)
    assert (found.first_bad, found.rows) == (None, 18)
    assert any("The database is damaged" in problem for problem in found.problems)


@pytest.mark.parametrize("guard", GUARDS)
def test_missing_guard_is_reported_although_all_rows_are_sound(path: Path, guard: str) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"DROP TRIGGER {guard}")
    with pytest.raises(JournalError, match=f"was changed: {guard} differs from"):
        Journal.open(path)
    found = verify(path)
    assert (found.first_bad, found.rows, found.sound) == (None, 18, False)
    (problem,) = found.problems
    assert guard in problem


@pytest.mark.parametrize(
    "record", [(0, b"", b"", b""), ("1", b"", b"", b""), (1, None, b"", b""), (1, b"", "text", b""), (1, b"", b"", 5)]
)
def test_record_with_wrong_types_is_an_error(record: tuple[Any, ...]) -> None:
    """As a damaged page may have it, whatever the table allows."""
    with pytest.raises(JournalError, match="does not have the content of a row"):
        stored_row(Path("journal.sqlite"), record)
