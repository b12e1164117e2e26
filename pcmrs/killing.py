"""The end of a child process that nobody listens to any more."""

from __future__ import annotations

import asyncio
from contextlib import suppress


async def kill_and_wait(process: asyncio.subprocess.Process) -> int:
    """Kill a child process that may have ended, wait for its end, and return its exit status.

    What it had written and nobody has read is thrown away. `Process.wait` alone would never return where that is more
    than a stream holds: it waits until the pipe is closed, and a stream that is full reads no further.
    """
    with suppress(ProcessLookupError):
        process.kill()
    await process.communicate()
    return await process.wait()
