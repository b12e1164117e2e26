"""Limits on processor and memory of a process, by control groups of version 1 or 2."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.needs import ROOT, Need
from pcmrs_lab.campaign.sham import is_sham

MOUNTED = Path("/sys/fs/cgroup")
PERIOD_US = 100_000
REALTIME_PERIOD_US = 1_000_000
"""The kernel's own."""


@contextmanager
def processor_quota(pids: Sequence[int], share: float) -> Iterator[None]:
    """The processes together get `share` of one processor, in periods of 0.1 s.

    A kernel that has groups for the real-time policy (version 1) gives threads with that policy the same share, in
    periods of 1 s, and refuses processes that have some where the group has none.
    """
    quota = max(1000, int(share * PERIOD_US))
    first = {"cpu.cfs_period_us": str(PERIOD_US), "cpu.cfs_quota_us": str(quota)}
    if (MOUNTED / "cpu" / "cpu.rt_runtime_us").exists():
        first["cpu.rt_runtime_us"] = str(int(share * REALTIME_PERIOD_US))
    with _group("cpu", first, {"cpu.max": f"{quota} {PERIOD_US}"}, pids):
        yield


@contextmanager
def memory_limit(pids: Sequence[int], limit: int) -> Iterator[Callable[[], int]]:
    """The processes together may not take more than `limit` bytes from now on; one that does is killed.

    Yields:
        How many the kernel has killed for that until now.
    """
    with _group("memory", {"memory.limit_in_bytes": str(limit)}, {"memory.max": str(limit)}, pids) as folder:
        yield partial(_killed, folder)


@contextmanager
def _group(controller: str, first: dict[str, str], second: dict[str, str], pids: Sequence[int]) -> Iterator[Path]:
    """A group of its own with its settings, those of version 1 or those of version 2; empty and gone at the end.

    In a sham campaign nobody is in it. Yields its folder.
    """
    own = MOUNTED / controller
    parent, settings = (own, first) if own.is_dir() else (MOUNTED, second)
    folder = parent / f"pcmrs-{uuid.uuid4().hex[:8]}"
    try:
        folder.mkdir()
        for name, value in settings.items():
            (folder / name).write_text(value)
        for pid in () if is_sham() else pids:
            (folder / "cgroup.procs").write_text(str(pid))
        yield folder
    except PermissionError as error:
        raise NotRun(f"Control groups cannot be written here: {error}.") from None
    finally:
        _dissolve(folder, parent)


def _killed(folder: Path) -> int:
    """How many processes of a group the kernel has killed for want of memory; 0 where it does not count."""
    for file in ("memory.events", "memory.oom_control"):
        if (folder / file).exists():
            lines = (line.split() for line in (folder / file).read_text().splitlines())
            return next((int(value) for key, value in lines if key == "oom_kill"), 0)
    return 0


def _dissolve(folder: Path, parent: Path) -> None:
    if folder.is_dir():
        for pid in (folder / "cgroup.procs").read_text().split():
            try:
                (parent / "cgroup.procs").write_text(pid)
            except OSError:
                continue  # it has ended meanwhile
        folder.rmdir()


def _is_there(controller: str) -> bool:
    """Whether the kernel has groups for this, of version 1 or of version 2."""
    if (MOUNTED / controller).is_dir():
        return True
    try:
        return controller in (MOUNTED / "cgroup.controllers").read_text().split()
    except OSError:
        return False


PROCESSOR = (Need("control groups for the processor", lambda: _is_there("cpu")), ROOT)
MEMORY = (Need("control groups for memory", lambda: _is_there("memory")), ROOT)
"""What the two limits need."""
