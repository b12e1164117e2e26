"""Journals whose files are cut and altered: all rows must be taken up, or a report made, never fewer in silence."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from journal_rows import intent, outcome, row

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, StoredRow, verify

NAME = "journal.sqlite"
LOG = f"{NAME}-wal"
HEAD = f"{NAME}.head"
Files = Mapping[str, bytes]


@dataclass(frozen=True)
class Sample:
    """A journal's files, and the rows that were acknowledged."""

    files: Files
    rows: list[StoredRow]


def sample(folder: Path, *, killed: bool, commits: int = 6) -> Sample:
    """A small journal as a kill leaves it, with its log, or as an orderly end does, in one file."""
    path = folder / NAME

    async def write() -> Sample:
        journal = Journal.open(path, durable=False)
        for number in range(commits):
            await journal.append([intent(f"c{number}"), outcome(f"c{number}"), row(result={"number": number})])
        rows = list(journal.reader.read())
        files = read_files(folder)
        await journal.close()
        return Sample(files if killed else read_files(folder), rows)

    return asyncio.run(write())


def read_files(folder: Path) -> dict[str, bytes]:
    """All files that outlive a process; SQLite's shared memory does, but is made anew after a reboot."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.endswith("-shm")}


def place(files: Files, folder: Path) -> Path:
    """Puts the files into a folder that holds nothing else; returns the path of the journal."""
    folder.mkdir(exist_ok=True)
    for path in folder.iterdir():
        path.unlink()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    if "journal.key" in files:
        (folder / "journal.key").chmod(0o600)
    return folder / NAME


def taken_up(whole: Sample, path: Path) -> bool:
    """Opens the journal and verifies it: True when it is taken up with every row, False when something is reported.

    Raises:
        AssertionError: A row is missing or another, and nobody says so.
    """
    before = {each.name: each.read_bytes() for each in path.parent.iterdir()}
    try:
        sound = verify(path).sound
    except JournalError:
        sound = False
    if (refusal := asyncio.run(_refusal(path))) is not None:
        # Verifying needs no private key.
        assert not sound or "journal.key" in refusal.text, f"verify has found nothing, and opening says: {refusal}"
        after = {each.name: each.read_bytes() for each in path.parent.iterdir()}
        left = [name for name in before if name != "journal.pub" and not name.endswith("-shm")]
        assert [name for name in left if after.get(name) != before[name]] == [], "a refused journal was changed"
        return False
    with JournalReader(path) as reader:
        assert list(reader.read())[: len(whole.rows)] == whole.rows
    return True


async def _refusal(path: Path) -> JournalError | None:
    """Opens and closes the journal; why that is refused."""
    try:
        journal = Journal.open(path, durable=False)
    except JournalError as error:
        return error
    await journal.close()
    return None


def cut(files: Files, name: str, length: int) -> dict[str, bytes]:
    """The files with one of them cut to a length; 0 leaves it empty, less removes it."""
    rest = {other: content for other, content in files.items() if other != name}
    return rest if length < 0 else rest | {name: files[name][:length]}


def flip(files: Files, name: str, bit: int) -> dict[str, bytes]:
    """The files with one bit of one of them turned over."""
    content = bytearray(files[name])
    content[bit // 8] ^= 1 << (bit % 8)
    return {**files, name: bytes(content)}
