"""Catalogue of an archive in a folder: a segment counts when it is in it."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from pcmrs.archive._catalogue import Catalogue, ListedSegment
from pcmrs.errors import ArchiveError, DoubledSegmentError
from tests.unit.archive.archives import entry_of, segment_of


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "catalogue.sqlite"


def listed(journal_path: Path) -> ListedSegment:
    return ListedSegment(segment_of(journal_path)[0], 7, bytes(32))


def test_what_was_entered_is_found_again(path: Path, journal_path: Path) -> None:
    entry, segment = entry_of(journal_path), listed(journal_path)
    with closing(Catalogue(path, make=True)) as catalogue:
        catalogue.begin(entry)
        with catalogue.entering(segment):
            pass
    with closing(Catalogue(path, make=False)) as catalogue:
        assert catalogue.journals() == [entry]
        assert catalogue.segments(entry.name) == [segment]


def test_an_error_in_between_enters_nothing(path: Path, journal_path: Path) -> None:
    segment = listed(journal_path)
    with closing(Catalogue(path, make=True)) as catalogue:
        catalogue.begin(entry_of(journal_path))
        with pytest.raises(OSError, match="disk"), catalogue.entering(segment):
            raise OSError("disk")
        assert catalogue.segments(segment.segment.journal) == []
        with catalogue.entering(segment):
            pass
        assert catalogue.segments(segment.segment.journal) == [segment]


def test_of_two_runs_one_is_refused(path: Path, journal_path: Path) -> None:
    segment = listed(journal_path)
    with closing(Catalogue(path, make=True)) as one, closing(Catalogue(path, make=True)) as other:
        one.begin(entry_of(journal_path))
        with one.entering(segment):
            pass
        with pytest.raises(DoubledSegmentError), other.entering(segment):
            pass
        with pytest.raises(DoubledSegmentError, match="another run at the same time"):
            other.begin(entry_of(journal_path))


def test_another_version_or_file_is_refused(path: Path) -> None:
    Catalogue(path, make=True).close()
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA user_version = 9")
    with pytest.raises(ArchiveError, match="version 9, this program supports 1"):
        Catalogue(path, make=False)
    path.write_bytes(b"not a database" * 100)
    with pytest.raises(ArchiveError, match="cannot be used"):
        Catalogue(path, make=True)


VIEW = (
    "CREATE VIEW journals AS WITH RECURSIVE n(site) AS (VALUES('a') UNION ALL SELECT site FROM n) "
    "SELECT site, site AS cell, site AS workflow, site AS first, x'' AS key, x'' AS head FROM n"
)


@pytest.mark.parametrize("table", [VIEW, "CREATE TABLE journals (site, cell, workflow, first, key, head)"])
def test_a_catalogue_with_other_tables_is_refused(path: Path, table: str) -> None:
    """A view could have endless rows, and columns without types any values."""
    Catalogue(path, make=True).close()
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("DROP TABLE segments")
        connection.execute("DROP TABLE journals")
        connection.execute(table)
    with pytest.raises(ArchiveError, match="has other tables"):
        Catalogue(path, make=False)
