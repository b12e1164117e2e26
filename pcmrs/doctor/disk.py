"""The disk under the journal: what kind it is, how long it takes to be sure of a write, and how much is free."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Final

from pcmrs.doctor.finding import Finding, bad, good, warning

WRITES: Final = 50
SLOW: Final = 0.05
"""A decision waits for two writes; operators notice more than 0.1 s."""
TOO_SLOW: Final = 1.0
"""`pcmrs health` says journal_slow from here on, s."""
NOT_KEPT: Final = ("tmpfs", "ramfs", "overlay")
REMOTE: Final = ("nfs", "nfs4", "cifs", "smb3", "9p", "fuse.sshfs")


def disk(folder: Path, mounts: Path = Path("/proc/self/mounts")) -> Iterator[Finding]:
    """Look at the disk of a folder that may not be there yet.

    Args:
        folder: Of the cell's journal and records.
        mounts: As proc(5) has it.
    """
    existing = next(each for each in (folder, *folder.absolute().parents) if each.is_dir())
    kind = _kind(existing, mounts)
    if kind in REMOTE:
        remedy = "Put cell.folder on a local disk: SQLite's log cannot be relied on over a network."
        yield bad("journal's disk", f"{folder} is on {kind}, over the network", remedy)
    elif kind in NOT_KEPT:
        remedy = "Put cell.folder on a disk, or mount a volume there: nothing in it outlives the machine or container."
        yield warning("journal's disk", f"{folder} is on {kind}, which is not kept", remedy)
    else:
        yield good("journal's disk", f"{folder} is on {kind or 'a disk'}")
    try:
        times = sync_times(existing)
    except OSError as error:
        remedy = f"Let the user who runs the daemon write in {existing}, or give another cell.folder."
        yield bad("time of fsync", f"{existing} cannot be written: {error.strerror}", remedy)
    else:
        yield judged(times)


def judged(times: list[float]) -> Finding:
    """What times of single writes mean, s each."""
    shown = f"median {median(times) * 1e3:.2g} ms, longest of {len(times)} {max(times) * 1e3:.2g} ms"
    if max(times) > TOO_SLOW:
        remedy = "Use another disk for cell.folder: decisions wait for it."
        return bad("time of fsync", f"{shown}; the limit is {TOO_SLOW * 1e3:g} ms", remedy)
    if max(times) > SLOW:
        remedy = "See what else writes to this disk (`iotop`); a local SSD takes less than 5 ms."
        return warning("time of fsync", f"{shown}; {SLOW * 1e3:g} ms are recommended", remedy)
    return good("time of fsync", shown)


def sync_times(folder: Path) -> list[float]:
    """Times of appending 4 KiB and waiting for the disk, s each. Raises `OSError`."""
    times = []
    with tempfile.TemporaryFile(dir=folder) as file:
        for _ in range(WRITES):
            began = time.perf_counter()
            os.write(file.fileno(), bytes(4096))
            os.fdatasync(file.fileno())
            times.append(time.perf_counter() - began)
    return times


def free_space(folder: Path, warn: float, floor: float) -> Iterator[Finding]:
    """Compare what is free with the limits of the running daemon.

    Args:
        folder: Of the journal; it may not be there yet.
        warn: The daemon warns below, bytes.
        floor: It accepts no state change below, bytes.
    """
    existing = next(each for each in (folder, *folder.absolute().parents) if each.is_dir())
    free = shutil.disk_usage(existing).free
    shown = f"{free / 1e9:.1f} GB"
    remedy = "Make room on the disk, or give another cell.folder."
    if free < floor:
        yield bad("free space", f"{shown}; below {floor / 1e9:.2g} GB no state change is accepted", remedy)
    elif free < warn:
        yield warning("free space", f"{shown}; the daemon warns below {warn / 1e9:.2g} GB", remedy)
    else:
        yield good("free space", shown)


def _kind(folder: Path, mounts: Path) -> str:
    """Type of the file system that a folder is on; empty where the kernel does not tell."""
    try:
        lines = [line.split()[1:3] for line in mounts.read_text().splitlines()]
    except OSError:
        return ""
    path = folder.resolve()
    found = [(len(point), kind) for point, kind in lines if path.is_relative_to(point.replace("\\040", " "))]
    return max(found)[1] if found else ""
