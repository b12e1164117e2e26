"""Adding journals to an archive: only new rows, only proven ones, and complete after any interruption."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.archive import ArchiveStore, add_journal, find_journals, verify_archive
from pcmrs.archive._columns import check_table
from pcmrs.archive._segment import Segment
from pcmrs.errors import AlteredSegmentError, ArchiveError, DoubledSegmentError, JournalError, MissingSegmentError
from pcmrs.journal import Journal, JournalReader
from tests import ROOT
from tests.support.trials import examples
from tests.unit.archive.archives import answer, commands, config, opened, write
from tests.unit.journal.edited_journal import edit


def ranges(store: ArchiveStore) -> list[tuple[int, int]]:
    (journal,) = store.journals()
    return [(segment.first, segment.last) for segment in store.segments(journal.name)]


def test_a_second_run_adds_what_is_new(store: ArchiveStore, journal_path: Path) -> None:
    assert add_journal(store, journal_path).added == 10
    assert add_journal(store, journal_path).added == 0
    write(journal_path, commands(2, start=3))
    added = add_journal(store, journal_path)
    assert (added.added, added.rows) == (6, 16)
    assert ranges(store) == [(1, 10), (11, 16)]
    assert verify_archive(store).sound
    assert answer(store, "SELECT count(*) AS n, max(sequence) AS last FROM rows") == [{"n": 16, "last": 16}]


def test_a_long_journal_has_several_segments(store: ArchiveStore, journal_path: Path) -> None:
    progress: list[tuple[int, int]] = []
    add_journal(store, journal_path, segment_rows=4, progress=lambda _, done, total: progress.append((done, total)))
    assert ranges(store) == [(1, 4), (5, 8), (9, 10)]
    assert progress == [(4, 10), (8, 10), (10, 10)]
    assert verify_archive(store).sound


def test_a_journal_without_rows_is_no_error(store: ArchiveStore, tmp_path: Path) -> None:
    added = add_journal(store, write(tmp_path / "ratms.sqlite", []))
    assert (added.journal, added.added) == ("", 0)
    assert store.journals() == []


async def test_a_journal_that_is_being_written_is_archived(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "ratms.sqlite"
    journal = Journal.open(path)
    with opened(folder) as store:
        await journal.append([config(), *commands(1)])
        assert add_journal(store, path).added == 4
        await journal.append(commands(1, start=1))
        assert add_journal(store, path).added == 3
        await journal.close()
        assert add_journal(store, path).added == 0
        assert verify_archive(store).sound


def test_a_damaged_journal_adds_nothing(store: ArchiveStore, journal_path: Path) -> None:
    edit(journal_path, "UPDATE journal SET body = zeroblob(9) WHERE sequence = 9")
    with pytest.raises(JournalError, match="row 9"):
        add_journal(store, journal_path, segment_rows=2)
    assert store.journals() == []


def test_a_journal_that_was_set_back_is_refused(store: ArchiveStore, journal_path: Path, tmp_path: Path) -> None:
    shutil.copytree(journal_path.parent, tmp_path / "earlier")
    set_back = tmp_path / "earlier" / journal_path.name
    write(journal_path, commands(1, start=3))
    add_journal(store, journal_path)
    for names, number in ((10, 50), (13, 60), (16, 70)):
        with pytest.raises(AlteredSegmentError, match=rf"names row {names}, does not have row 13 as it was archived"):
            add_journal(store, set_back)
        write(set_back, commands(1, start=number))
    assert ranges(store) == [(1, 13)]


def test_one_journal_is_not_archived_for_two_cells(store: ArchiveStore, journal_path: Path) -> None:
    add_journal(store, journal_path)
    with pytest.raises(DoubledSegmentError, match=r"Rows 1–10 of oslo/c2/.* is in the archive as lab/cell1/"):
        add_journal(store, journal_path, cell=("oslo", "c2"))


def test_a_copy_of_a_journal_adds_nothing(store: ArchiveStore, journal_path: Path, tmp_path: Path) -> None:
    add_journal(store, journal_path)
    shutil.copytree(journal_path.parent, tmp_path / "copy")
    assert add_journal(store, tmp_path / "copy" / journal_path.name).added == 0
    assert len(store.journals()) == 1


def test_two_journals_of_one_cell_are_two(store: ArchiveStore, journal_path: Path, tmp_path: Path) -> None:
    first = msgspec.structs.replace(config(), session_id="another")
    add_journal(store, journal_path)
    add_journal(store, write(tmp_path / "new" / "ratms.sqlite", [first, *commands(1)]))
    assert [journal.name[:3] for journal in store.journals()] == [("lab", "cell1", "ratms")] * 2
    assert verify_archive(store).sound
    assert answer(store, "SELECT count(*) AS n FROM rows") == [{"n": 14}]


def test_another_key_is_refused(store: ArchiveStore, journal_path: Path, tmp_path: Path) -> None:
    add_journal(store, journal_path)
    with pytest.raises(AlteredSegmentError, match=r"journal.pub beside .* is another key"):
        add_journal(store, write(tmp_path / "other" / "ratms.sqlite", [config(), *commands(3)]))


def test_a_hole_in_the_archive_is_no_place_to_continue(
    folder: Path, journal_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with opened(folder) as store:
        add_journal(store, journal_path, segment_rows=4)
        segments = store.segments(store.journals()[0].name)
        monkeypatch.setattr(store, "segments", lambda _: [segments[0], segments[2]])
        with pytest.raises(MissingSegmentError, match="Rows 5–8"):
            add_journal(store, journal_path)


def test_an_error_while_storing_ends_the_run(folder: Path, journal_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with opened(folder) as store:
        real = store.add

        def add(segment: Segment, table: object) -> None:
            if segment.first == 5:
                raise ArchiveError("The disk is full.")
            real(segment, table)

        with monkeypatch.context() as patch:
            patch.setattr(store, "add", add)
            with pytest.raises(ArchiveError, match="full"):
                add_journal(store, journal_path, segment_rows=4)
        assert ranges(store) == [(1, 4)]
        (result,) = verify_archive(store).journals
        assert (result.rows, result.unproven) == (4, 4)
        assert add_journal(store, journal_path).added == 6
        assert verify_archive(store).journals[0].unproven == 0


KILLED = """
import os, signal, sys
from pathlib import Path
from pcmrs.archive import add_journal, _folder as folder, open_store

calls = 0
def killing(real):
    def call(*words):
        global calls
        calls += 1
        if calls == int(sys.argv[3]) and sys.argv[4] == "before":
            os.kill(os.getpid(), signal.SIGKILL)
        result = real(*words)
        if calls == int(sys.argv[3]):
            os.kill(os.getpid(), signal.SIGKILL)
        return result
    return call

folder.publish = killing(folder.publish)
add_journal(open_store(sys.argv[1], make=True), Path(sys.argv[2]), segment_rows=4)
"""


@pytest.mark.parametrize("number", [1, 2, 3])
@pytest.mark.parametrize("when", ["before", "after"])
def test_a_killed_run_leaves_a_usable_archive(folder: Path, journal_path: Path, number: int, when: str) -> None:
    command = [sys.executable, "-c", KILLED, str(folder), str(journal_path), str(number), when]
    killed = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    with opened(folder) as store:
        kept = 4 * (number - 1)
        verified = verify_archive(store)
        assert verified.sound
        assert (verified.journals[0].rows, verified.journals[0].unproven) == (kept, kept)
        assert len(verified.unlisted) == 1
        assert answer(store, "SELECT count(*) AS n FROM rows") == [{"n": kept}]
        assert add_journal(store, journal_path).added == 10 - kept
        verified = verify_archive(store)
        assert (verified.problems, verified.unlisted, verified.journals[0].unproven) == ((), (), 0)
        for segment in store.segments(store.journals()[0].name):
            check_table(segment, store.read(segment))


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(1, 5)), min_size=1, max_size=4))
@examples(5)
def test_runs_of_any_size_archive_the_journal(runs: list[tuple[int, int]]) -> None:
    """Each run follows a number of commands, and makes segments of a number of rows."""
    with TemporaryDirectory() as name, opened(Path(name) / "archive") as store:
        path, written = write(Path(name) / "cell" / "ratms.sqlite", [config()]), 0
        for count, segment_rows in runs:
            write(path, commands(count, start=written))
            written += count
            add_journal(store, path, segment_rows=segment_rows)
        with JournalReader(path) as reader:
            stored = [(each.sequence, each.hash) for each in reader.read()]
        found = answer(store, "SELECT sequence, hash FROM rows ORDER BY sequence")
        assert [(each["sequence"], each["hash"]) for each in found] == stored
        assert verify_archive(store).sound


def test_the_journals_of_a_folder_are_found(journal_path: Path, tmp_path: Path) -> None:
    other = write(journal_path.with_name("femoroplasty.sqlite"), [config()])
    assert find_journals([journal_path.parent]) == [other, journal_path]
    assert find_journals([journal_path]) == [journal_path]
    for nothing in (tmp_path / "none", tmp_path):
        with pytest.raises(JournalError, match="There is no journal"):
            find_journals([nothing])
