"""Verification of an archive: each missing, altered or doubled segment is found and named."""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pcmrs.archive import ArchiveStore, ArchiveVerification, add_journal, verify_archive
from pcmrs.archive._folder import CATALOGUE
from tests.unit.archive.archives import commands, config, opened, write


@pytest.fixture
def archive(folder: Path, journal_path: Path, tmp_path: Path) -> Path:
    """An archive of two journals, of three segments and one."""
    with opened(folder) as store:
        add_journal(store, journal_path, segment_rows=4)
        add_journal(store, write(tmp_path / "cell2" / "ratms.sqlite", [config("oslo", "c2"), *commands(1)]))
    return folder


def verified(folder: Path) -> ArchiveVerification:
    with opened(folder) as store:
        return verify_archive(store)


def catalogue(folder: Path, statement: str) -> None:
    with closing(sqlite3.connect(folder / CATALOGUE, isolation_level=None)) as connection:
        assert connection.execute(statement).rowcount > 0


def file(folder: Path, first: int) -> Path:
    (found,) = folder.glob(f"rows/lab/cell1/*/{first:012d}.parquet")
    return found


def test_a_whole_archive_is_sound(store: ArchiveStore, journal_path: Path) -> None:
    add_journal(store, journal_path, segment_rows=4)
    steps: list[tuple[int, int]] = []
    found = verify_archive(store, progress=lambda _, done, total: steps.append((done, total)))
    assert found.sound
    (journal,) = found.journals
    assert (journal.segments, journal.rows, journal.unproven) == (3, 10, 0)
    assert steps == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize("first", [1, 5, 9])
def test_a_missing_file_is_named(archive: Path, first: int) -> None:
    file(archive, first).unlink()
    (problem,) = verified(archive).problems
    assert problem.code == "segment_missing"
    assert problem.journal.startswith("lab/cell1/")
    assert f"Rows {first}–{min(first + 3, 10)} of lab/cell1/ratms" in problem.text
    assert "Put it back from a copy" in problem.text


@pytest.mark.parametrize(("first", "rows"), [(1, "1–4"), (5, "5–8"), (9, "9–10")])
def test_a_segment_taken_out_of_the_catalogue_is_named(archive: Path, first: int, rows: str) -> None:
    statement = "DELETE FROM segments WHERE start = {} AND journal IN (SELECT first FROM journals WHERE site = 'lab')"
    catalogue(archive, statement.format(first - 1))
    found = verified(archive)
    (problem,) = found.problems
    assert (problem.code, f"Rows {rows} of lab/cell1" in problem.text) == ("segment_missing", True)
    assert len(found.unlisted) == 1


def forge(folder: Path, column: str, value: str) -> None:
    """Alter a column of the second segment, and its hash in the catalogue, too."""
    path = file(folder, 5)
    table = pq.ParquetFile(path).read()
    values = pa.array([value, *table.column(column).to_pylist()[1:]], pa.string())
    pq.write_table(table.set_column(table.schema.get_field_index(column), column, values), path)
    with closing(sqlite3.connect(folder / CATALOGUE, isolation_level=None)) as connection:
        listed = (hashlib.sha256(path.read_bytes()).digest(), path.stat().st_size)
        connection.execute("UPDATE segments SET sha256 = ?, bytes = ? WHERE start = 4", listed)


def test_altered_columns_are_found_whatever_the_catalogue_says(archive: Path) -> None:
    forge(archive, "source", "bus:eve")
    (problem,) = verified(archive).problems
    assert (problem.code, "source in segment 5–8" in problem.text) == ("segment_altered", True)


def test_a_segment_in_the_place_of_another_is_found(archive: Path) -> None:
    shutil.copyfile(file(archive, 1), file(archive, 5))
    problems = verified(archive).problems
    assert [problem.code for problem in problems] == ["segment_altered"]


def test_a_doubled_segment_is_found(archive: Path) -> None:
    catalogue(archive, "UPDATE segments SET start = 3 WHERE start = 4")
    codes = [problem.code for problem in verified(archive).problems]
    assert codes.count("segment_doubled") == 1


def test_a_head_of_another_cell_is_found(archive: Path) -> None:
    catalogue(archive, "UPDATE journals SET head = (SELECT head FROM journals WHERE site = 'oslo') WHERE site = 'lab'")
    (problem,) = verified(archive).problems
    assert "its head is not signed with its public key" in problem.text


def test_a_damaged_key_does_not_end_the_verification(archive: Path) -> None:
    catalogue(archive, "UPDATE journals SET key = x'00' WHERE site = 'lab'")
    found = verified(archive)
    (problem,) = found.problems
    assert "is not the public key of a journal" in problem.text
    assert [journal.rows for journal in found.journals] == [10, 4]


def test_a_key_that_was_kept_elsewhere_is_compared(archive: Path, journal_path: Path, tmp_path: Path) -> None:
    own, other = (path.with_name("journal.pub").read_bytes() for path in (journal_path, tmp_path / "cell2" / "_"))
    with opened(archive) as store:
        assert verify_archive(store, keys={"lab/cell1": own, "oslo/c2": other}).sound
        (problem,) = verify_archive(store, keys={"lab/cell1": other}).problems
    assert "its public key is not the one that was given for lab/cell1" in problem.text


def test_all_problems_are_reported_together(archive: Path) -> None:
    file(archive, 1).unlink()
    file(archive, 9).write_bytes(b"")
    found = verified(archive)
    assert [problem.code for problem in found.problems] == ["segment_missing", "segment_altered"]
    assert [journal.rows for journal in found.journals] == [4, 4]
    assert not found.sound
