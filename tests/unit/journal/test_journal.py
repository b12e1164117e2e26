"""Journal: order, the hash chain, what cannot be done to it, and how it fails."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader
from pcmrs.journal.rows import GENESIS, encode_row
from tests.unit.journal.journal_rows import intent, outcome, row


async def test_rows_come_back_in_order_without_gaps(journal: Journal) -> None:
    rows = [intent("a"), outcome("a"), row("device", result={"code": "link_lost"})]
    assert await journal.append(rows[:2]) == 2
    assert await journal.append(rows[2:]) == 3
    stored = list(journal.reader.read())
    assert [item.row for item in stored] == rows
    assert [item.sequence for item in stored] == [1, 2, 3]


async def test_the_chain_continues_over_a_restart(path: Path) -> None:
    for part in range(3):
        journal = Journal.open(path, durable=part != 1)
        await journal.append([row(result={"part": part}), row()])
        await journal.close()
    with JournalReader(path) as reader:
        previous = GENESIS
        for number, stored in enumerate(reader.read(), start=1):
            body = encode_row(stored.row)
            assert stored.sequence == number
            assert stored.previous_hash == previous
            previous = hashlib.sha256(previous + number.to_bytes(8, "big") + body).digest()
            assert stored.hash == previous
    assert number == 6


async def test_first_rows_cost_the_same_in_a_long_and_a_short_journal(path: Path) -> None:
    journal = Journal.open(path, durable=False)

    def cost() -> int:
        """Steps of SQLite's machine for five rows."""
        steps: list[None] = []
        journal.reader._files[-1][1].set_progress_handler(lambda: steps.append(None), 1)
        assert [stored.sequence for stored in journal.reader.read(after=3, first=5)] == [4, 5, 6, 7, 8]
        journal.reader._files[-1][1].set_progress_handler(None, 1)
        return len(steps)

    await journal.append([row()] * 20)
    short = cost()
    for _ in range(10):
        await journal.append([row()] * 200)
    assert cost() <= short  # the first one reads the schema as well
    await journal.close()


async def test_a_row_that_is_no_data_is_refused_and_harms_nothing(journal: Journal) -> None:
    with pytest.raises(JournalError, match="cannot be journalled"):
        journal.append([row(arguments={"pose": object()})])
    assert await journal.append([row()]) == 1
