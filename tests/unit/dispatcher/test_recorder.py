"""The interface to the journal: rows on their way to the disk."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable

import pytest

from pcmrs.dispatcher.recorder import QueuedRow
from pcmrs.errors import JournalError


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
    failed: list[JournalError] = []

    def queue() -> Awaitable[None]:
        queued.append("row")
        return durable

    row = asyncio.create_task(QueuedRow(queue, failed.append).durable())
    assert queued == ["row"]
    await asyncio.sleep(0)
    assert not row.done()
    durable.set_result(None)
    await row
    assert (queued, failed) == (["row"], [])
