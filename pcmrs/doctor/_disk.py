"""Checks of the disk under the journal: its kind, the duration of a durable write, and the free space."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Final

from pcmrs.doctor._check_result import CheckResult, bad, good, warning

WRITES: Final = 50
SLOW: Final = 0.05
"""Recommended limit of a write, s. A decision waits for two writes; operators notice more than 0.1 s."""
TOO_SLOW: Final = 1.0
"""Limit of a write, s, from which `pcmrs health` reports journal_slow."""
NOT_KEPT: Final = ("tmpfs", "ramfs", "overlay")
REMOTE: Final = ("nfs", "nfs4", "cifs", "smb3", "9p", "fuse.sshfs")


def disk(folder: Path, mounts: Path = Path("/proc/self/mounts")) -> Iterator[CheckResult]:
    """Check the disk of a folder that may not exist yet.

    Args:
        folder: Folder of the cell's journal and records.
        mounts: Table of mounts, as in proc(5).
    """
    existing = next(each for each in (folder, *folder.absolute().parents) if each.is_dir())
    kind = _kind(existing, mounts)
    if kind in REMOTE:
        remedy = "Put cell.folder on a local disk: SQLite's log cannot be relied on over a network."
        yield bad("journal's disk", f"{folder} is on {kind}, over the network", remedy)
    elif kind in NOT_KEPT:
        remedy = (
            "Put cell.folder on a disk, or mount a volume there: its contents are lost with the machine or container."
        )
        yield warning("journal's disk", f"{folder} is on {kind}, which does not persist", remedy)
    else:
        yield good("journal's disk", f"{folder} is on {kind or 'a disk'}")
    try:
        times = _sync_times(existing)
    except OSError as error:
        remedy = f"Let the user who runs the daemon write in {existing}, or give another cell.folder."
        yield bad("time of fsync", f"{existing} cannot be written: {error.strerror}", remedy)
    else:
        yield assess_times(times)


def assess_times(times: list[float]) -> CheckResult:
    """Return the finding on the durations of single writes, s each."""
    shown = f"median {median(times) * 1e3:.2g} ms, longest of {len(times)} {max(times) * 1e3:.2g} ms"
    if max(times) > TOO_SLOW:
        remedy = "Use another disk for cell.folder: decisions wait for it."
        return bad("time of fsync", f"{shown}; the limit is {TOO_SLOW * 1e3:g} ms", remedy)
    if max(times) > SLOW:
        remedy = "See what else writes to this disk (`iotop`); a local SSD takes less than 5 ms."
        return warning("time of fsync", f"{shown}; {SLOW * 1e3:g} ms are recommended", remedy)
    return good("time of fsync", shown)


def _sync_times(folder: Path) -> list[float]:
    """Return the durations of appending 4 KiB and waiting for the disk, s each.

    Raises:
        OSError: The folder cannot be written.
    """
    times = []
    with tempfile.TemporaryFile(dir=folder) as file:
        for _ in range(WRITES):
            began = time.perf_counter()
            os.write(file.fileno(), bytes(4096))
            os.fdatasync(file.fileno())
            times.append(time.perf_counter() - began)
    return times


def free_space(folder: Path, warn: float, floor: float) -> Iterator[CheckResult]:
    """Compare the free space with the limits of the running daemon.

    Args:
        folder: Folder of the journal; it may not exist yet.
        warn: Below this the daemon warns, bytes.
        floor: Below this the daemon accepts no state change, bytes.
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
    """Return the type of the file system of a folder; empty if the kernel does not report it."""
    try:
        lines = [line.split()[1:3] for line in mounts.read_text().splitlines()]
    except OSError:
        return ""
    path = folder.resolve()
    found = [(len(point), kind) for point, kind in lines if path.is_relative_to(point.replace("\\040", " "))]
    return max(found)[1] if found else ""
