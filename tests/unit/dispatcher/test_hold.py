"""A hold that was asked for goes on, whoever gives up waiting for it."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from pcmrs.background import BackgroundTasks
from pcmrs.dispatcher.stops import Hold


async def test_hold_continues_when_its_caller_is_cancelled() -> None:
    tasks, stands, held = BackgroundTasks(print), asyncio.Event(), asyncio.Event()

    async def hold(_latch: bool) -> None:
        await stands.wait()
        held.set()

    asked = asyncio.create_task(Hold(hold, tasks).end_motion())
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    asked.cancel()
    with suppress(asyncio.CancelledError):
        await asked
    stands.set()
    await tasks.wait()

    assert held.is_set()
