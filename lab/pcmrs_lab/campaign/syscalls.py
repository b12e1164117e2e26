"""System calls of a running process that fail or wait, by strace's injection, optionally only on given files."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pcmrs.testing.needs import ROOT, program
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.sham import is_sham

NEEDS = (program("strace"), ROOT)

ATTACHES_WITHIN = 10.0
"""Time within which the tracer holds all threads, s of the machine."""


@dataclass
class Tampered:
    """Number of calls that have been tampered with so far."""

    calls: int = 0


@asynccontextmanager
async def injected(
    pid: int, calls: Sequence[str], action: str, *, files: Sequence[Path] = (), threads: bool = True
) -> AsyncIterator[Tampered]:
    """Tamper with the system calls of a process for the length of the context.

    Args:
        pid: Id of the process.
        calls: Names of system calls.
        action: Action in strace's notation, such as ``error=EIO`` or ``delay_enter=2000000`` (µs), with ``when=`` if
            needed.
        files: Files whose calls are affected; all if empty.
        threads: True for all threads, False for the main one only.

    Yields:
        Number of affected calls; complete when the context has ended.

    Raises:
        NotRun: strace may not attach.
    """
    if is_sham():
        yield Tampered()
        return
    paths = [word for file in files for word in ("-P", str(file))]
    words = [*(["-f"] if threads else []), "-p", str(pid), *paths, "-e", f"trace={','.join(calls)}"]
    tracer = await asyncio.create_subprocess_exec(
        "strace",
        *words,
        "-e",
        f"inject={','.join(calls)}:{action}",
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
    )
    tampered = Tampered()
    counting = asyncio.create_task(_count(tracer, tampered))
    try:
        await _wait_until_attached(pid, tracer, threads=threads)
        yield tampered
    finally:
        with suppress(ProcessLookupError):
            tracer.terminate()
        await tracer.wait()
        await counting


async def _wait_until_attached(pid: int, tracer: asyncio.subprocess.Process, *, threads: bool) -> None:
    try:
        async with asyncio.timeout(ATTACHES_WITHIN):
            while not all(map(_is_traced, _threads(pid) if threads else [pid])):
                if tracer.returncode is not None:
                    raise NotRun("strace cannot attach to a process here.")
                await asyncio.sleep(0.02)
    except TimeoutError:
        raise NotRun(f"strace did not attach within {ATTACHES_WITHIN:g} s.") from None


def _threads(pid: int) -> list[int]:
    return [int(task.name) for task in Path(f"/proc/{pid}/task").iterdir()]


def _is_traced(thread: int) -> bool:
    try:
        status = Path(f"/proc/{thread}/status").read_text()
    except OSError:
        return True  # the thread has ended
    return "TracerPid:\t0\n" not in status


async def _count(tracer: asyncio.subprocess.Process, tampered: Tampered) -> None:
    """Read the tracer's output, so that it never blocks, and count the affected calls."""
    if tracer.stderr is not None:
        async for line in tracer.stderr:
            tampered.calls += line.rstrip().endswith((b"(INJECTED)", b"(DELAYED)"))
