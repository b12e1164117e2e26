"""A copy of a journal has the head that belongs to it, or is not made."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, copy_journal, export, verify
from pcmrs.journal.rows import encode_row
from pcmrs.journal.writer import JournalWriter
from pcmrs.testing.journal import HEAD, NAME, append_past_head
from tests.unit.journal.edited_journal import macs
from tests.unit.journal.journal_rows import row


def test_journal_without_its_head_is_not_copied_as_whole(whole_path: Path, tmp_path: Path) -> None:
    whole_path.with_name(HEAD).unlink()
    with pytest.raises(JournalError, match="head is missing"):
        copy_journal(whole_path, tmp_path / "copy" / NAME)


def test_the_head_of_a_copy_names_its_last_row(
    whole_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a row was written after the head was read."""
    writer, copied = JournalWriter(whole_path, durable=False), export._copy_database

    def copy_later(*paths: Path) -> Any:
        writer.write([(row(), encode_row(row()))])
        return copied(*paths)

    monkeypatch.setattr(export, "_copy_database", copy_later)
    copy_journal(whole_path, tmp_path / "copy" / NAME)
    writer.close()
    found = verify(tmp_path / "copy" / NAME)
    assert (found.sound, found.rows, found.signed) == (True, 19, 19)


async def test_a_journal_that_is_written_is_copied_with_its_head(killed_path: Path, tmp_path: Path) -> None:
    (tmp_path / "copy").mkdir()
    journal = Journal.open(killed_path)
    appended = [journal.append([row()]) for _ in range(50)]
    for _ in range(5):
        copy_journal(killed_path, tmp_path / "copy" / NAME)
        assert verify(tmp_path / "copy" / NAME).sound
    for each in appended:
        await each
    await journal.close()
    assert verify(killed_path).rows == 68


def test_a_copy_keeps_what_tells_rows_of_a_crash_from_others(whole_path: Path, tmp_path: Path) -> None:
    append_past_head(whole_path, [row()])
    copy_journal(whole_path, tmp_path / "copy" / NAME)
    assert macs(tmp_path / "copy" / NAME) == macs(whole_path)
