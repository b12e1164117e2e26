"""A small journal as a kill leaves it, with its log, or as an orderly end does, in one file."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from pathlib import Path

from pcmrs.journal import Journal, StoredRow
from pcmrs.testing.journal import NAME, contents
from tests.unit.journal.journal_rows import intent, outcome, row

LOG = f"{NAME}-wal"


@dataclass(frozen=True)
class Sample:
    """A journal's files, name to content, and the rows that were acknowledged."""

    files: dict[str, bytes]
    rows: list[StoredRow]


def sample(folder: Path, *, killed: bool, commits: int = 6) -> Sample:
    """Writes three rows with each commit."""
    path = folder / NAME

    async def write() -> Sample:
        journal = Journal.open(path, durable=False)
        for number in range(commits):
            await journal.append([intent(f"c{number}"), outcome(f"c{number}"), row(result={"number": number})])
        rows = list(journal.reader.read())
        files = contents(folder)
        await journal.close()
        return Sample(files if killed else contents(folder), rows)

    return asyncio.run(write())


def name_of(descriptor: int) -> str:
    return Path(f"/proc/self/fd/{descriptor}").readlink().name
