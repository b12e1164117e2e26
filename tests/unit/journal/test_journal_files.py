"""Files beside the journal: nothing has its name before the disk has it, and nothing half written is left or counts."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pcmrs.errors import JournalError
from pcmrs.files import settle_on_disk, write_durably
from pcmrs.journal import JournalReader
from pcmrs.journal.head import Head, begin_head, head_path, read_head
from pcmrs.journal.keys import signing_key
from pcmrs.journal.rows import RowPosition, encode_row
from pcmrs.journal.writer import JournalWriter
from tests.unit.journal.journal_rows import row

ROW = (row(), encode_row(row()))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.sqlite"


@pytest.fixture
def synced(path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, set[str]]]:
    """What the disk was asked to take, by its name, and what was in the folder then."""
    calls: list[tuple[str, set[str]]] = []
    sync = os.fsync

    def spy(descriptor: int) -> None:
        sync(descriptor)
        calls.append((_name(descriptor), {each.name for each in path.parent.iterdir()}))

    monkeypatch.setattr(os, "fsync", spy)
    return calls


@pytest.mark.parametrize("name", ["journal.key", "journal.pub", "journal.sqlite", "journal.sqlite.head"])
def test_file_is_synchronised_before_and_after_it_gets_its_name(
    path: Path, synced: list[tuple[str, set[str]]], name: str
) -> None:
    JournalWriter(path, durable=True).close()
    as_part = [number for number, (what, there) in enumerate(synced) if what == f"{name}.part" and name not in there]
    named = [number for number, (what, there) in enumerate(synced) if what == path.parent.name and name in there]
    assert len(as_part) == 1
    assert as_part[0] + 1 in named


def test_failed_write_leaves_no_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="No space"):
        write_durably(path, b"content", mode=0o600)
    assert list(path.parent.iterdir()) == []


def test_reads_after_a_failure_come_from_the_disk(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel forgets that it could not write, and shows what it would have written."""
    asked: list[tuple[str, str]] = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: asked.append(("take", _name(descriptor))))
    monkeypatch.setattr(os, "posix_fadvise", lambda descriptor, *_: asked.append(("forget", _name(descriptor))))
    path.write_bytes(b"content")
    settle_on_disk([path, path.with_name("missing")])
    assert asked == [("take", path.name), ("forget", path.name)]


def test_reopening_settles_all_files(path: Path, synced: list[tuple[str, set[str]]]) -> None:
    writer = JournalWriter(path, durable=True)
    writer.write([ROW])
    synced.clear()
    writer.reopen()
    writer.close()
    settled = {path.name, f"{path.name}.head", path.parent.name}
    assert {name for name, _ in synced} == settled, "the log is gone when all is closed"


@pytest.mark.parametrize("durable", [True, False])
def test_the_disk_has_the_head_before_a_row_is_acknowledged(
    path: Path, monkeypatch: pytest.MonkeyPatch, durable: bool
) -> None:
    asked: list[str] = []
    writer, sync = JournalWriter(path, durable=durable), os.fdatasync

    def spy(descriptor: int) -> None:
        sync(descriptor)
        asked.append(_name(descriptor))

    monkeypatch.setattr(os, "fdatasync", spy)
    for _ in range(3):
        writer.write([ROW])
    assert asked == [f"{path.name}.head"] * 3 * durable
    writer.close()


def test_the_head_names_only_what_is_committed(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a crash between the two looks like a lost row."""
    writer = JournalWriter(path, durable=True)
    write, seen = writer._head.write, []

    def look(place: RowPosition) -> None:
        with JournalReader(path) as reader:
            seen.append((place.sequence, reader.last_sequence()))
        write(place)

    monkeypatch.setattr(writer._head, "write", look)
    for _ in range(2):
        writer.write([ROW])
    assert seen == [(1, 1), (2, 2)]
    writer.close()


def test_half_a_head_is_no_head(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer, write = JournalWriter(path, durable=True), os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda descriptor, data, place: write(descriptor, data[:50], place))
    with pytest.raises(JournalError, match="only 50 of 120 bytes"):
        writer.write([ROW])
    assert writer.error is not None
    writer.close()


def test_unacknowledged_row_may_be_gone_at_the_second_reopening(path: Path) -> None:
    """It was on the disk when the first one failed, and the disk has lost it since."""
    writer = JournalWriter(path, durable=True)
    writer.write([ROW])
    writer.close()
    kept = {each: each.read_bytes() for each in path.parent.iterdir()}
    writer = JournalWriter(path, durable=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "pwrite", lambda *_: 0)
        with pytest.raises(JournalError):
            writer.write([ROW])
        with pytest.raises(JournalError):
            writer.reopen()
    path.with_name(f"{path.name}-wal").write_bytes(b"")
    for each, content in kept.items():
        each.write_bytes(content)
    assert writer.reopen() == 1
    writer.close()


def test_a_torn_write_leaves_the_head_before_it(path: Path) -> None:
    writer = JournalWriter(path, durable=True)
    for _ in range(5):
        writer.write([ROW])
    key = signing_key(path.parent, make=False)
    content = head_path(path).read_bytes()
    for torn in (0, 1):
        spoiled = path.with_name("torn.head")
        spoiled.write_bytes(content[: torn * 4096] + bytes(100) + content[torn * 4096 + 100 :])
        state = read_head(spoiled, key.public_key())
        assert state is not None
        assert state.head is not None
        assert state.head.place.sequence in (4, 5)
    writer.close()


def test_of_two_whole_slots_the_newer_counts(path: Path) -> None:
    key = signing_key(path.parent, make=True)
    for older, newer in ((0, 1), (1, 0)):
        begin_head(head_path(path), key)
        slots = {
            older: Head(7, RowPosition(7, bytes(32))).pack(key),
            newer: Head(8, RowPosition(9, bytes(32))).pack(key),
        }
        head_path(path).write_bytes(slots[0].ljust(4096, b"\0") + slots[1].ljust(4096, b"\0"))
        state = read_head(head_path(path), key.public_key())
        assert state is not None
        assert state.head == Head(8, RowPosition(9, bytes(32)))


def test_only_its_owner_may_read_the_key(path: Path) -> None:
    JournalWriter(path, durable=True).close()
    assert path.with_name("journal.key").stat().st_mode & 0o777 == 0o600


def _name(descriptor: int) -> str:
    return Path(f"/proc/self/fd/{descriptor}").readlink().name
