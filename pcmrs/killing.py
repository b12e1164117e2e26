"""Ending of a child process whose output nobody reads any more."""

from __future__ import annotations

import asyncio
from contextlib import suppress


async def kill_and_wait(process: asyncio.subprocess.Process) -> int:
    """Kill a child process that may have ended, wait for its end, and return its exit status.

    Unread output is discarded. `Process.wait` alone would never return if there is more of it than a stream holds: it
    waits until the pipe is closed, and a full stream stops reading.
    """
    with suppress(ProcessLookupError):
        process.kill()
    await process.communicate()
    return await process.wait()
