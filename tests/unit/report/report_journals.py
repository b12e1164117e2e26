"""Journals for reports: golden ones made anew, and altered on the way."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.journal import Journal, JournalRow
from tests.unit.replay.golden import GOLDEN

Row = dict[str, Any]


def golden_rows(workflow: str) -> list[Row]:
    """The rows of a golden journal as plain data; the one with sequence n is at n - 1."""
    lines = (GOLDEN / f"{workflow}.jsonl").read_text().splitlines()
    return [json.loads(line)["row"] for line in lines]


def write_journal(rows: Sequence[Row], path: Path) -> Path:
    """A signed journal of these rows."""
    path.parent.mkdir(parents=True, exist_ok=True)
    asyncio.run(_write([msgspec.convert(row, JournalRow) for row in rows], path))
    return path


async def _write(rows: list[JournalRow], path: Path) -> None:
    journal = Journal.open(path, durable=False)
    for row in rows:
        await journal.append([row])
    await journal.close()


def altered(rows: Sequence[Row], change: Callable[[Row], None]) -> list[Row]:
    """Copies of the rows, each given to `change`."""
    copies: list[Row] = json.loads(json.dumps(rows))
    for row in copies:
        change(row)
    return copies
