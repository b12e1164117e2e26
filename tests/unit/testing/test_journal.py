"""Files of a journal: what is written into a folder is a journal again."""

from __future__ import annotations

import asyncio
import stat
from pathlib import Path

import pytest

from pcmrs.journal import Journal, JournalReader
from pcmrs.testing.journal import HEAD, KEY, NAME, contents, place
from tests.unit.journal.journal_rows import intent, outcome


def written(folder: Path) -> dict[str, bytes]:
    """Return the files of a journal of two rows that is still open, as a kill leaves them."""

    async def write() -> dict[str, bytes]:
        journal = Journal.open(folder / NAME, durable=False)
        await journal.append([intent("a"), outcome("a")])
        files = contents(folder)
        await journal.close()
        return files

    return asyncio.run(write())


def test_files_of_a_journal_are_a_journal_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "first").mkdir()
    files = written(tmp_path / "first")
    path = place(files, tmp_path / "second")
    assert path == tmp_path / "second" / NAME
    with JournalReader(path) as journal:
        assert [stored.row for stored in journal.read()] == [intent("a"), outcome("a")]


def test_shared_memory_is_left_out_as_a_reboot_does(tmp_path: Path) -> None:
    (tmp_path / "first").mkdir()
    files = written(tmp_path / "first")
    assert {NAME, f"{NAME}-wal"} <= files.keys()
    assert not any(name.endswith("-shm") for name in files)


def test_every_byte_is_written_and_the_key_is_its_owners_alone(tmp_path: Path) -> None:
    files = {NAME: bytes(range(256)), HEAD: b"", KEY: b"secret"}
    path = place(files, tmp_path / "new")
    assert contents(path.parent) == files
    assert stat.S_IMODE((path.parent / KEY).stat().st_mode) == 0o600


def test_a_folder_that_is_there_is_not_mixed_with_another_journal(tmp_path: Path) -> None:
    with pytest.raises(FileExistsError):
        place({NAME: b""}, tmp_path)
