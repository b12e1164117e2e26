"""Reading: narrowed, across files, by command, and while a daemon writes."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, StoredRow
from tests.unit.journal.journal_rows import intent, outcome, row


async def test_the_recorded_verdict_outlives_a_restart(path: Path) -> None:
    journal = Journal.open(path, durable=False)
    await journal.append([intent("a", "udp:planner"), outcome("a", "udp:planner"), intent("b", "udp:planner")])
    await journal.close()
    journal = Journal.open(path, durable=False)
    assert journal.reader.verdict_of("udp:planner", "a") == outcome("a").verdict
    assert journal.reader.verdict_of("udp:planner", "b") is None
    assert journal.reader.verdict_of("bus:local", "a") is None
    await journal.close()


async def test_reading_can_be_narrowed(journal: Journal) -> None:
    await journal.append([intent("a"), outcome("a"), row("device"), intent("b", "udp:x")])
    read = journal.reader.read

    def sequences(rows: Iterable[StoredRow]) -> list[int]:
        return [stored.sequence for stored in rows]

    assert sequences(read(kind="intent")) == [1, 4]
    assert sequences(read(branch="registration", after=1)) == [2, 4]
    assert sequences(read(source="udp:x")) == [4]
    assert sequences(read(command_id="a")) == [1, 2]
    assert sequences(read(last=2)) == [3, 4]
    assert sequences(read(first=2)) == [1, 2]
    assert sequences(read(first=1, last=2)) == [3]
    assert sequences(read(after=2, first=1)) == [3]
    assert sequences(read(branch="registration", last=2)) == [2, 4]


async def test_reading_continues_while_a_daemon_writes(path: Path) -> None:
    journal = Journal.open(path)
    with JournalReader(path) as reader:
        for number in range(1, 6):
            await journal.append([row()])
            assert [stored.sequence for stored in reader.read()] == list(range(1, number + 1))
        rows = reader.read()
        next(rows)
        # A half-read listing keeps its view and holds nobody up.
        await journal.append([row()])
        assert len(list(rows)) == 4
    await journal.close()


@pytest.mark.parametrize("content", [b"", b"not a database at all, just some text" * 40])
def test_a_file_that_is_no_journal_cannot_be_read(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(JournalError, match="another file"):
        JournalReader(path)
