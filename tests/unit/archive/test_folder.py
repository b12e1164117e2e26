"""Archive in a folder: private, complete after a kill, and readable by other software."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import duckdb
import pyarrow.dataset as ds
import pytest

from pcmrs.archive._folder import FolderStore
from pcmrs.archive._segment import Segment
from pcmrs.errors import AlteredSegmentError, ArchiveError, MissingSegmentError
from tests.unit.archive.archives import answer, entry_of, segment_of


@pytest.fixture
def store(folder: Path) -> Iterator[FolderStore]:
    made = FolderStore(folder, make=True)
    yield made
    made.close()


@pytest.fixture
def segment(store: FolderStore, journal_path: Path) -> Segment:
    """A segment of the archive."""
    segment, table = segment_of(journal_path)
    store.begin(entry_of(journal_path))
    store.add(segment, table)
    return segment


def file_of(folder: Path) -> Path:
    (path,) = folder.rglob("*.parquet")
    return path


def test_only_its_owner_can_enter_the_folder(store: FolderStore, folder: Path) -> None:
    assert folder.stat().st_mode & 0o777 == 0o700


def test_the_file_has_the_name_of_cell_and_first_row(segment: Segment, folder: Path) -> None:
    assert file_of(folder) == folder / "rows" / str(segment.journal) / "000000000001.parquet"


def test_a_missing_file_is_named_and_no_question_answered(store: FolderStore, segment: Segment, folder: Path) -> None:
    file_of(folder).unlink()
    for use in (lambda: store.read(segment), lambda: answer(store, "SELECT count(*) FROM rows")):
        with pytest.raises(MissingSegmentError, match=r"Rows 1–10 of lab/cell1/ratms.* there is no ") as raised:
            use()
        assert raised.value.fields["cell"] == "lab/cell1"


def test_a_file_of_another_size_is_found_by_a_question(store: FolderStore, segment: Segment, folder: Path) -> None:
    with file_of(folder).open("ab") as file:
        file.write(b"\0")
    with pytest.raises(AlteredSegmentError, match="bytes, and had"):
        answer(store, "SELECT count(*) FROM rows")


@pytest.mark.parametrize("place", [0.0, 0.3, 0.7, 0.999])
def test_a_flipped_bit_is_found(store: FolderStore, segment: Segment, folder: Path, place: float) -> None:
    path = file_of(folder)
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] ^= 1
    path.write_bytes(content)
    with pytest.raises(AlteredSegmentError, match="another SHA-256 than the catalogue"):
        store.read(segment)


def test_files_of_killed_runs_do_not_count_and_are_replaced(
    store: FolderStore, journal_path: Path, folder: Path
) -> None:
    segment, table = segment_of(journal_path)
    store.begin(entry_of(journal_path))
    left = folder / "rows" / str(segment.journal)
    left.mkdir(parents=True)
    (left / "000000000001.parquet").write_bytes(b"half")  # killed before it was in the catalogue
    (left / "000000000001.parquet.1.part").write_bytes(b"less")  # killed before it had its name
    assert answer(store, "SELECT count(*) AS rows FROM rows") == [{"rows": 0}]
    assert len(store.unlisted()) == 2
    store.add(segment, table)
    assert store.read(segment).equals(table)
    assert store.unlisted() == []


def test_a_question_reads_no_other_file(store: FolderStore, segment: Segment, tmp_path: Path) -> None:
    secret = tmp_path / "secret.csv"
    secret.write_text("a\n1\n")
    for sql in (
        f"SELECT * FROM read_csv('{secret}')",
        f"SELECT * FROM '{secret}'",
        f"COPY (SELECT 1) TO '{secret}'",
        f"ATTACH '{secret}.db'",
        "SET enable_external_access = true",
    ):
        with pytest.raises(ArchiveError):
            answer(store, sql)
    assert secret.read_text() == "a\n1\n"


def test_other_software_reads_the_files(store: FolderStore, segment: Segment, folder: Path) -> None:
    assert ds.dataset(folder / "rows", format="parquet").count_rows() == 10  # as Dask does
    files = str(folder / "rows" / "**" / "*.parquet")
    with duckdb.connect() as connection:
        found = connection.execute("SELECT count(*), min(site) FROM read_parquet(?)", [files]).fetchall()
    assert found == [(10, "lab")]


def test_a_folder_with_other_files_is_left_alone(tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    home.chmod(0o755)
    (home / "letter.txt").touch()
    with pytest.raises(ArchiveError, match=r"such as letter\.txt: give a new or empty folder"):
        FolderStore(home, make=True)
    assert home.stat().st_mode & 0o777 == 0o755
    assert [path.name for path in home.iterdir()] == ["letter.txt"]


def test_a_folder_whose_making_was_killed_is_used(folder: Path) -> None:
    folder.mkdir()
    (folder / "catalogue.sqlite.part").write_bytes(b"half")
    made = FolderStore(folder, make=True)
    assert made.journals() == []
    made.close()


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ArchiveError, match="cannot be made"):
        FolderStore(tmp_path / "file" / "archive", make=True)
