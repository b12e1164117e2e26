"""The interface to the journal: rows on their way to the disk, and clipped arguments."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.dispatcher.recorder import CLIPPED, LONGEST, QueuedRow, clipped
from pcmrs.errors import JournalError


def test_short_arguments_are_kept_and_of_long_ones_the_hash() -> None:
    short, long = {"text": "x"}, {"text": "x" * LONGEST}
    assert clipped(short) == short
    kept = clipped(long)
    assert set(kept) == {CLIPPED}
    assert kept[CLIPPED]["bytes"] > LONGEST
    assert clipped({"text": "x" * (LONGEST - 1) + "y"})[CLIPPED]["sha256"] != kept[CLIPPED]["sha256"]
    assert clipped(kept) == kept


@pytest.mark.parametrize("at_once", [True, False])
async def test_lost_row_is_reported_to_its_owner_and_not_raised(at_once: bool) -> None:
    """Whether the journal refuses to queue it or fails to write it."""
    lost = JournalError("The disk is full.")
    reported: list[JournalError] = []

    async def write() -> None:
        raise lost

    def queue() -> Awaitable[None]:
        if at_once:
            raise lost
        return write()

    await QueuedRow(queue, reported.append)
    assert reported == [lost]


async def test_row_is_queued_at_once_and_awaited_until_it_is_durable() -> None:
    """Commands that are submitted after it must be journalled after it."""
    durable: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    queued: list[str] = []

    def queue() -> Awaitable[None]:
        queued.append("row")
        return durable

    row = asyncio.create_task(QueuedRow(queue, queued.append).durable())
    assert queued == ["row"]
    await asyncio.sleep(0)
    assert not row.done()
    durable.set_result(None)
    await row
    assert queued == ["row"], "nothing has failed"


@given(st.dictionaries(st.text(), st.text() | st.floats(allow_nan=False) | st.lists(st.integers())))
def test_clipped_arguments_never_exceed_the_limit(arguments: dict[str, Any]) -> None:
    whole = msgspec.json.encode(arguments, order="sorted")
    for stored in (clipped(arguments), clipped(arguments | {"padding": "x" * LONGEST})):
        assert len(msgspec.json.encode(stored)) <= LONGEST
    assert (clipped(arguments) is arguments) == (len(whole) <= LONGEST)
