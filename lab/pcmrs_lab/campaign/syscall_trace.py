"""System calls by which a process writes a journal, recorded by strace."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from pcmrs.testing.needs import program
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.tools import require

NEEDS = (program("strace"),)

CALLS = "openat,write,pwrite64,ftruncate,fsync,fdatasync,rename,unlink"
LONGEST = 100_000
"""Longest recorded write, bytes; of a longer one only a part would be recorded."""


def trace_journal(folder: Path, commits: int, seed: int, *, durable: bool = True) -> list[str]:
    """Have a process write a journal in a folder, and record its system calls.

    Args:
        folder: Folder to create.
        commits: Number of commits.
        seed: Seed of their sizes.
        durable: False for the control: a writer that does not wait for the disk, which a power cut must be seen to
            harm.

    Returns:
        System calls in the order of time, as strace prints them: a line for each, or for its beginning and its end.

    Raises:
        NotRun: strace is missing, or may not trace.
    """
    require(NEEDS)
    folder.mkdir()
    trace = folder.with_suffix(".trace")
    words = ["strace", "-f", "-y", "-xx", "-s", str(LONGEST), "-e", f"trace={CALLS}", "-e", "signal=none"]
    writer = [sys.executable, "-m", "pcmrs_lab.campaign.writing", str(folder), str(commits), str(seed)]
    writer.append("durable" if durable else "careless")
    run = subprocess.run(
        [*words, "-o", str(trace), *writer], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False
    )
    if run.returncode != 0:
        raise NotRun(f"strace cannot record here: {run.stderr.strip()[-500:]}")
    return trace.read_text().splitlines()
