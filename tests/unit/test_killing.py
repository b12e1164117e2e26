"""A child process ends when it is killed, whatever it has written."""

from __future__ import annotations

import asyncio
import signal
import sys

from pcmrs.clock import SystemClock
from pcmrs.killing import kill_and_wait

FULL = 1 << 17
"""Of a stream that nobody reads, bytes: more than this it does not take."""


async def child(program: str) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(sys.executable, "-c", program, stdout=asyncio.subprocess.PIPE)


async def test_one_that_nobody_reads_ends() -> None:
    process = await child("while True: print('x' * 80)")
    assert process.stdout is not None
    while len(process.stdout._buffer) <= FULL:  # type: ignore[attr-defined]  # noqa: ASYNC110  # nothing else tells
        await asyncio.sleep(0)
    async with SystemClock().timeout(60.0):
        assert await kill_and_wait(process) == -signal.SIGKILL


async def test_one_that_has_ended_keeps_its_status() -> None:
    process = await child("raise SystemExit(7)")
    await process.wait()
    assert await kill_and_wait(process) == 7
