"""The signed head names only what is committed; a torn slot or a forged one is none."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, verify
from pcmrs.journal.head import Head, begin_head, head_path, read_head
from pcmrs.journal.keys import signing_key
from pcmrs.journal.rows import RowPosition
from pcmrs.journal.writer import JournalWriter
from pcmrs.testing.journal import HEAD, place
from tests.unit.journal.journal_rows import ROW, row
from tests.unit.journal.whole_journal import Sample, name_of


def test_signature_for_another_purpose_is_no_head(whole_path: Path) -> None:
    key, head = signing_key(whole_path.parent, make=False), whole_path.with_name(HEAD)
    message = struct.pack(">8sQQ32s", b"PCMRSXX1", 1000, 3, bytes(32))
    content = bytearray(head.read_bytes())
    content[:120] = message + key.sign(message)
    head.write_bytes(content)
    state = read_head(head, key.public_key())
    assert state is not None
    assert state.damaged == 1
    assert state.head is not None
    assert state.head.counter < 1000


@pytest.mark.parametrize("durable", [True, False])
def test_the_disk_has_the_head_before_a_row_is_acknowledged(
    path: Path, monkeypatch: pytest.MonkeyPatch, durable: bool
) -> None:
    asked: list[str] = []
    writer, sync = JournalWriter(path, durable=durable), os.fdatasync

    def spy(descriptor: int) -> None:
        sync(descriptor)
        asked.append(name_of(descriptor))

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


async def test_head_stored_elsewhere_shows_that_all_was_set_back(killed_path: Path, killed_journal: Sample) -> None:
    journal = Journal.open(killed_path)
    await journal.append([row()])
    await journal.close()
    kept = killed_path.parent.parent / "kept.head"
    kept.write_bytes(killed_path.with_name(HEAD).read_bytes())
    assert verify(killed_path, kept=kept).sound
    set_back = place(killed_journal.files, killed_path.parent.with_name("set back"))
    assert verify(set_back).sound
    assert not verify(set_back, kept=kept).sound
    kept.write_bytes(killed_journal.files[HEAD])
    assert verify(set_back, kept=kept).sound


async def test_second_writer_is_refused_and_the_first_continues(killed_path: Path) -> None:
    journal = Journal.open(killed_path)
    with pytest.raises(JournalError, match="Another process writes"):
        Journal.open(killed_path)
    assert await journal.append([row()]) == 19
    await journal.close()
