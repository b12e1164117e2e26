"""The reader process as its parent has it: begun, listened to, and ended when it hangs."""

from __future__ import annotations

import asyncio
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncGenerator
from contextlib import suppress

from pcmrs.clock import Clock
from pcmrs.devices.ndi.wire import Failed, Frame, Job, Ready, Unpacker, pack
from pcmrs.errors import DeviceError
from pcmrs.killing import killed

SETUP_TIME = 35.0
"""The reader says that the tracker tracks, or why not, within this, s: longer than its own limit."""
FRAME_TIME = 2.0
"""Then it reports something within this, s: longer than its own limit."""
CHUNK = 1 << 16

MODULE = "pcmrs.devices.ndi.reader"


async def reports(job: Job, clock: Clock) -> AsyncGenerator[Ready | Frame, None]:
    """Everything that a reader with this job reports; it ends with this iterator.

    Raises:
        DeviceError: The tracker is not there, refuses, or has ceased to answer.
        PayloadError: The reader reports what is no report.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", MODULE, stdin=PIPE, stdout=PIPE, start_new_session=True
    )
    unpacker, limit = Unpacker(), SETUP_TIME
    try:
        await _give(process, job)
        while data := await _read(process, clock, limit):
            for report in unpacker.feed(data):
                if isinstance(report, Failed):
                    raise DeviceError(report.text)
                limit = FRAME_TIME
                yield report
        raise DeviceError(_why_ended(await process.wait()))
    finally:
        await killed(process)


async def _give(process: Process, job: Job) -> None:
    assert process.stdin is not None
    process.stdin.write(pack(job))
    with suppress(ConnectionError):  # it has ended, and its end is what is told
        await process.stdin.drain()


async def _read(process: Process, clock: Clock, limit: float) -> bytes:
    assert process.stdout is not None
    try:
        async with clock.timeout(limit):
            return await process.stdout.read(CHUNK)
    except TimeoutError:
        raise DeviceError(f"the reader has reported nothing for {limit:g} s") from None


def _why_ended(status: int) -> str:
    if status == -signal.SIGALRM:
        return "it does not answer"
    if status == -signal.SIGSEGV:
        return "an answer was corrupted"  # which `ndicapi` 3.7 does not survive when it is one of BX
    return f"the reader ended with exit status {status}"
