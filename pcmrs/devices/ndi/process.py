"""The reader process from its parent's side: started, read, and ended if it hangs."""

from __future__ import annotations

import asyncio
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncGenerator
from contextlib import suppress

from pcmrs.clock import Clock
from pcmrs.devices.ndi.wire import Failed, NdiFrame, ReaderJob, TrackerReady, Unpacker, pack
from pcmrs.errors import DeviceError
from pcmrs.killing import kill_and_wait

SETUP_TIME = 35.0
"""Time within which the reader reports that the tracker tracks, or why not, s: longer than the reader's own limit."""
FRAME_TIME = 2.0
"""Longest time between two later reports, s: longer than the reader's own limit."""
CHUNK = 1 << 16
"""Number of bytes that are read at once."""

MODULE = "pcmrs.devices.ndi.reader"
"""Module that the reader process runs."""


class BeepLine:
    """Line to the reader process that tracks now, for beeps; without one, nothing is heard."""

    def __init__(self) -> None:
        self._reader: asyncio.StreamWriter | None = None

    def connect(self, reader: asyncio.StreamWriter | None) -> None:
        """Use the standard input of a reader from now on, or of none."""
        self._reader = reader

    def beep(self, count: int) -> None:
        """Let the tracker beep, 1 to 9 times."""
        if self._reader is not None:
            self._reader.write(bytes((count,)))


async def read_reports(
    job: ReaderJob, clock: Clock, beeps: BeepLine | None = None
) -> AsyncGenerator[TrackerReady | NdiFrame, None]:
    """Start a reader process and yield its reports; the process ends with this iterator.

    Args:
        job: Address of the tracker, and its tools.
        clock: Clock of the machine, for timeouts.
        beeps: Line that is connected to the reader while the tracker tracks.

    Raises:
        DeviceError: The tracker is absent, refuses, or has stopped answering.
        PayloadError: The output of the reader is not a report.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", MODULE, stdin=PIPE, stdout=PIPE, start_new_session=True
    )
    unpacker, limit = Unpacker(), SETUP_TIME
    try:
        await _send_job(process, job)
        while data := await _read(process, clock, limit):
            for report in unpacker.feed(data):
                if isinstance(report, Failed):
                    raise DeviceError(report.text)
                if beeps is not None and isinstance(report, TrackerReady):
                    beeps.connect(process.stdin)
                limit = FRAME_TIME
                yield report
        raise DeviceError(_end_text(await process.wait()))
    finally:
        if beeps is not None:
            beeps.connect(None)
        await kill_and_wait(process)


async def _send_job(process: Process, job: ReaderJob) -> None:
    assert process.stdin is not None
    process.stdin.write(pack(job))
    with suppress(ConnectionError):  # the process has ended, and its end is reported instead
        await process.stdin.drain()


async def _read(process: Process, clock: Clock, limit: float) -> bytes:
    assert process.stdout is not None
    try:
        async with clock.timeout(limit):
            return await process.stdout.read(CHUNK)
    except TimeoutError:
        raise DeviceError(f"the reader has reported nothing for {limit:g} s") from None


def _end_text(status: int) -> str:
    if status == -signal.SIGALRM:
        return "it does not answer"
    if status == -signal.SIGSEGV:
        return "an answer was corrupted"  # `ndicapi` 3.7 crashes on a corrupted answer to BX
    return f"the reader ended with exit status {status}"
