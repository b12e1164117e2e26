"""The writer that is killed says every row that it has committed, and why it cannot write."""

from __future__ import annotations

import asyncio
import os
import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, JournalRow, journal_files
from pcmrs_lab.campaign import writing
from pcmrs_lab.campaign.writing import PARALLEL, REFUSED, SEQUENCE, SESSIONS, write

TO = 1009
"""Descriptor of a pipe that nobody has."""


class Written:
    """What a writer has said, on its standard output or to the pipe."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.output = b""
        self._other = os.write
        monkeypatch.setattr(os, "write", self._write)

    def _write(self, descriptor: int, data: bytes) -> int:
        if descriptor not in (1, TO):
            return self._other(descriptor, data)
        self.output += data
        return len(data)

    @property
    def sequences(self) -> list[int]:
        return [sequence for (sequence,) in SEQUENCE.iter_unpack(self.output)]


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> Written:
    return Written(monkeypatch)


class KilledError(Exception):
    """The writer is killed."""


class ScriptedJournal:
    """A journal that is killed after so many commits."""

    def __init__(self) -> None:
        self.rows: list[JournalRow] = []
        self.commits = 0

    async def append(self, rows: Sequence[JournalRow]) -> int:
        self.rows += rows
        self.commits += 1
        if self.commits > 20:
            raise KilledError
        last = len(self.rows)
        await asyncio.sleep(0)
        return last


def test_every_committed_row_is_said_after_it_was(written: Written, monkeypatch: pytest.MonkeyPatch) -> None:
    journal, armed = ScriptedJournal(), list[str]()
    monkeypatch.setattr(Journal, "open", lambda _: journal)
    monkeypatch.setattr(writing, "arm", armed.append)
    with pytest.raises(KilledError):
        write(Path("journal.sqlite"), "run0", 5, "journal.commit:3", TO)
    begun, *said = written.sequences
    assert begun == 0, "it has begun"
    assert len(said) == len(set(said)) <= 20
    assert said
    assert max(said) < len(journal.rows), "the last commit was not answered"
    assert {each.source for each in journal.rows} == {f"writer{number}" for number in range(PARALLEL)}
    assert armed == ["journal.commit:3"]


def test_a_journal_that_cannot_be_opened_is_said_with_its_reason(
    written: Written, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: Path) -> Journal:
        raise JournalError("The head is damaged.")

    monkeypatch.setattr(Journal, "open", refuse)
    write(Path("journal.sqlite"), "run0", 5, "", TO)
    assert written.output == SEQUENCE.pack(0) + SEQUENCE.pack(REFUSED) + b"The head is damaged."


def test_a_recorded_journal_has_every_row_that_was_said(
    written: Written, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("sys.argv", ["writing", str(tmp_path), "12", "3", "careless"])
    writing.main()
    said = [int(line) for line in written.output.split()]
    path = tmp_path / "journal.sqlite"
    with JournalReader(path) as reader:
        rows = list(reader.read())
    assert sorted(said) == [stored.sequence for stored in rows if (stored.row.source or "").startswith("writer")]
    assert {"run0", "run1"} <= {stored.row.session_id for stored in rows}
    assert len(journal_files(path)) == SESSIONS, "each session continues in a new file"


def test_a_seed_fixes_what_is_written(written: Written, monkeypatch: pytest.MonkeyPatch) -> None:
    outputs: list[Any] = []
    for seed in (1, 1, 2):
        journal = ScriptedJournal()
        monkeypatch.setattr(Journal, "open", lambda _, made=journal: made)
        written.output = b""
        with pytest.raises(KilledError):
            asyncio.run(writing._write(Path("j"), "run0", random.Random(seed), TO))
        outputs.append([(each.source, each.operation) for each in journal.rows])
    assert outputs[0] == outputs[1] != outputs[2]
