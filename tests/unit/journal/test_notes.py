"""Rows of the journal about itself: after a crash, a torn head, and the upgrade of an older version."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.journal import Journal, verify
from pcmrs.journal.schema import VERSION, WITHOUT_MAC
from pcmrs.testing.journal import HEAD
from tests.unit.journal.edited_journal import macs, operations
from tests.unit.journal.journal_rows import row


async def test_unnamed_rows_left_by_a_crash_are_adopted_and_journalled(
    killed_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal.open(killed_path, durable=False)
    monkeypatch.setattr(journal._writer._head, "write", lambda place: None)
    await journal.append([row(), row()])
    await journal.close()
    assert verify(killed_path).unnamed == 2
    assert verify(killed_path).sound
    for _ in range(2):
        await Journal.open(killed_path).close()
    assert operations(killed_path) == ["head_behind"]
    assert verify(killed_path).unnamed == 0


async def test_one_torn_slot_is_enough_and_is_journalled(killed_path: Path) -> None:
    head = killed_path.with_name(HEAD)
    head.write_bytes(head.read_bytes()[:4096] + bytes(4096))
    assert verify(killed_path).damaged_slots == 1
    for _ in range(2):
        await Journal.open(killed_path).close()
    assert "head_damaged" in operations(killed_path)
    assert verify(killed_path).damaged_slots == 0


async def test_journal_of_version_1_is_upgraded_and_that_is_journalled(version_1: Path) -> None:
    found = verify(version_1)
    assert found.sound
    assert found.signature == "none"
    for _ in range(2):
        journal = Journal.open(version_1)
        assert journal.reader.verdict_of("bus:local", "c2") is not None
        await journal.close()
    assert operations(version_1) == ["head_begun"]
    found = verify(version_1)
    assert found.sound
    assert (found.version, found.rows, found.signed) == (3, 9, 9)


async def test_journal_of_version_2_continues_with_macs_for_new_rows(version_2: Path) -> None:
    assert (verify(version_2).version, verify(version_2).sound) == (WITHOUT_MAC, True)
    for _ in range(2):
        journal = Journal.open(version_2)
        assert journal.reader.verdict_of("bus:local", "c2") is not None
        await journal.close()
    assert operations(version_2) == ["mac_begun"]
    found = verify(version_2)
    assert (found.sound, found.version, found.rows, found.signed) == (True, VERSION, 10, 10)
    assert [mac is not None for mac in macs(version_2)] == [False] * 9 + [True]
