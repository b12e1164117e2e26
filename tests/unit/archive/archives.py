"""Journals of cells for archive tests, and archives of them."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa

from pcmrs.archive import ArchiveStore, open_store
from pcmrs.archive._columns import end_of, table_of
from pcmrs.archive._segment import Segment
from pcmrs.archive._source import JournalSource
from pcmrs.archive._store import ArchivedJournal
from pcmrs.journal import Journal, JournalRow
from pcmrs.journal.rows import START, RowPosition
from pcmrs.messages import Reason, Verdict
from tests.unit.journal.journal_rows import intent, outcome, row


def config(site: str = "lab", name: str = "cell1") -> JournalRow:
    """The first row of a daemon, with the name of its cell."""
    return row("config", operation="started", result={"settings": {"cell": {"site": site, "name": name}}})


def commands(count: int, start: int = 0) -> list[JournalRow]:
    """Three rows for each command, with values of all kinds."""
    rows = []
    for number in range(start, start + count):
        name = f"c{number}"
        rows += [intent(name), outcome(name), row("device", source="robot", operation="moved", result={"é": number})]
    return rows


def failed(command_id: str, code: str) -> JournalRow:
    """The outcome of an operation that a Stop has ended."""
    reason = Reason(code=code, text="Stopped.")
    fields: dict[str, Any] = {"branch": "robot", "operation": "approach"}
    verdict = Verdict(id=command_id, decision="failed", state="1", sequence=1, reason=reason, **fields)
    return row("outcome", command_id=command_id, source="bus:local", verdict=verdict, **fields)


def write(path: Path, rows: list[JournalRow]) -> Path:
    """Append rows to a journal, which is made if there is none."""

    async def append() -> None:
        journal = Journal.open(path, durable=False)
        for each in rows:
            await journal.append([each])
        await journal.close()

    path.parent.mkdir(exist_ok=True)
    asyncio.run(append())
    return path


@contextmanager
def opened(place: Path | str) -> Iterator[ArchiveStore]:
    """An archive, which is made if there is none."""
    store = open_store(str(place), make=True)
    try:
        yield store
    finally:
        store.close()


def segment_of(path: Path, after: RowPosition = START, most: int = 100) -> tuple[Segment, pa.Table]:
    """A segment of a journal, and its rows."""
    with JournalSource(path) as source:
        name = source.name()
        table = table_of(name, source.read(after, most))
    return Segment(name, after, end_of(table)), table


def entry_of(path: Path) -> ArchivedJournal:
    """The entry of a journal in a catalogue, as its first run makes it."""
    with JournalSource(path) as source:
        return ArchivedJournal(source.name(), source.key, b"")


def answer(store: ArchiveStore, sql: str) -> list[dict[str, Any]]:
    """The rows of an answer."""
    with store.ask(sql) as reader:
        rows: list[dict[str, Any]] = reader.read_all().to_pylist()
    return rows
