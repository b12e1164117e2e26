"""Ending of a child process whose output nobody reads any more."""

from __future__ import annotations

from contextlib import suppress
from typing import Protocol


class KillableProcess(Protocol):
    """What is used of `asyncio.subprocess.Process`."""

    def kill(self) -> None: ...

    async def communicate(self) -> tuple[bytes | None, bytes | None]: ...

    async def wait(self) -> int: ...


async def kill_and_wait(process: KillableProcess) -> int:
    """Kill a child process that may have ended, wait for its end, and return its exit status.

    Unread output is discarded. `Process.wait` alone would never return if there is more of it than a stream holds: it
    waits until the pipe is closed, and a full stream stops reading.
    """
    with suppress(ProcessLookupError):
        process.kill()
    await process.communicate()
    return await process.wait()
