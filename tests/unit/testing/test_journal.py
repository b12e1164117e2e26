"""Files of a journal are a journal again elsewhere; they are damaged where the damage says, and at no other place."""

from __future__ import annotations

import asyncio
import stat
from pathlib import Path

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader
from pcmrs.testing.journal import (
    HEAD,
    KEY,
    NAME,
    Damage,
    append_past_head,
    append_without_key,
    contents,
    place,
    row,
)
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


def test_an_existing_folder_is_not_mixed_with_another_journal(tmp_path: Path) -> None:
    with pytest.raises(FileExistsError):
        place({NAME: b""}, tmp_path)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return the files of a closed journal of three rows."""

    async def write() -> None:
        journal = Journal.open(folder / NAME)
        await journal.append([intent("a"), outcome("a"), row("run0", 0, 1)])
        await journal.close()

    folder = tmp_path_factory.mktemp("journal")
    asyncio.run(write())
    return contents(folder)


@pytest.fixture
def journal(files: dict[str, bytes], tmp_path: Path) -> Path:
    return place(files, tmp_path / "copy")


def changed(files: dict[str, bytes], folder: Path) -> list[str]:
    after = contents(folder)
    return sorted(name for name in files | after if files.get(name) != after.get(name))


def test_a_cut_leaves_the_bytes_before_it(files: dict[str, bytes], journal: Path) -> None:
    Damage(NAME, 100).apply(journal.parent)
    assert journal.read_bytes() == files[NAME][:100]
    assert changed(files, journal.parent) == [NAME]


def test_a_flip_inverts_one_bit(files: dict[str, bytes], journal: Path) -> None:
    Damage(HEAD, 3, flip=7).apply(journal.parent)
    before, after = files[HEAD], (journal.parent / HEAD).read_bytes()
    assert [(place, a ^ b) for place, (a, b) in enumerate(zip(before, after, strict=True)) if a != b] == [(3, 0x80)]


def test_a_file_is_removed(files: dict[str, bytes], journal: Path) -> None:
    Damage(HEAD, -1).apply(journal.parent)
    assert changed(files, journal.parent) == [HEAD]
    assert not (journal.parent / HEAD).exists()


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (Damage("a", 9), "a cut at byte 9"),
        (Damage("a", -1), "a removed"),
        (Damage("a", 9, flip=0), "a bit 0 flipped in byte 9"),
    ],
)
def test_a_damage_says_what_it_does(damage: Damage, text: str) -> None:
    assert str(damage) == text


def test_a_row_tells_who_wrote_it_when() -> None:
    made = row("run3", 2, 650)
    assert (made.session_id, made.source, made.operation) == ("run3", "writer2", "650")
    assert {len(str(row("run3", 0, number).arguments)) for number in (0, 699, 700)} == {
        len(str(row("run3", 0, 0).arguments)),
        len(str(row("run3", 0, 699).arguments)),
    }


def test_rows_without_the_key_are_chained_but_not_believed(journal: Path) -> None:
    append_without_key(journal, [row("forged", 0, 1), row("forged", 0, 2)])
    with JournalReader(journal) as reader:
        assert [stored.row.session_id for stored in reader.read()][-2:] == ["forged", "forged"]
    with pytest.raises(JournalError):
        Journal.open(journal)


async def test_rows_past_the_head_are_those_of_a_crash(files: dict[str, bytes], journal: Path) -> None:
    append_past_head(journal, [row("late", 0, 1)])
    assert (journal.parent / HEAD).read_bytes() == files[HEAD]
    opened = Journal.open(journal)
    sessions = [stored.row.session_id for stored in opened.reader.read()]
    await opened.close()
    assert "late" in sessions, "a crash makes no journal unusable"
