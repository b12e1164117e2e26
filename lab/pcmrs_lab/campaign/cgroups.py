"""Limits on processor time and memory of processes, by Linux control groups of version 1 or 2."""

from __future__ import annotations

import errno
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from pcmrs.testing.needs import ROOT, Need
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.sham import is_sham

MOUNTED = Path("/sys/fs/cgroup")
PERIOD_US = 100_000
REALTIME_PERIOD_US = 1_000_000
"""Default period of the kernel for the real-time policy."""
FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)
"""Errors of groups that exist and may not be written, such as those that a container mounts read-only."""


@contextmanager
def processor_quota(pids: Sequence[int], share: float) -> Iterator[None]:
    """Limit the processor time of processes together, in periods of 0.1 s, for the length of the context.

    A kernel with groups for the real-time policy (version 1) gives threads with that policy the same share, in periods
    of 1 s. It refuses processes with such threads if the group has no share for them.

    Args:
        pids: Ids of the processes.
        share: Share of one processor.
    """
    quota = max(1000, int(share * PERIOD_US))
    first = {"cpu.cfs_period_us": str(PERIOD_US), "cpu.cfs_quota_us": str(quota)}
    if (MOUNTED / "cpu" / "cpu.rt_runtime_us").exists():
        first["cpu.rt_runtime_us"] = str(int(share * REALTIME_PERIOD_US))
    with _group("cpu", first, {"cpu.max": f"{quota} {PERIOD_US}"}, pids):
        yield


@contextmanager
def memory_limit(pids: Sequence[int], limit: int) -> Iterator[Callable[[], int]]:
    """Limit the memory of processes together for the length of the context; the kernel kills a process that exceeds it.

    Args:
        pids: Ids of the processes.
        limit: Limit, bytes. Only memory that is allocated from now on counts.

    Yields:
        Function that returns how many processes the kernel has killed for it.
    """
    with _group("memory", {"memory.limit_in_bytes": str(limit)}, {"memory.max": str(limit)}, pids) as folder:
        yield partial(_killed, folder)


@contextmanager
def _group(controller: str, first: dict[str, str], second: dict[str, str], pids: Sequence[int]) -> Iterator[Path]:
    """Make a control group with its settings, those of version 1 or those of version 2, and remove it at the end.

    It stays empty in a sham campaign. Yields its folder.
    """
    own = MOUNTED / controller
    parent, settings = (own, first) if own.is_dir() else (MOUNTED, second)
    folder = parent / f"pcmrs-{uuid.uuid4().hex[:8]}"
    try:
        _make(folder, settings, pids)
        yield folder
    finally:
        _remove_group(folder, parent)


def _make(folder: Path, settings: dict[str, str], pids: Sequence[int]) -> None:
    try:
        folder.mkdir()
        for name, value in settings.items():
            (folder / name).write_text(value)
        for pid in () if is_sham() else pids:
            (folder / "cgroup.procs").write_text(str(pid))
    except OSError as error:
        if error.errno not in FORBIDDEN:
            raise
        raise NotRun(f"Control groups cannot be written here: {error}.") from None


def _killed(folder: Path) -> int:
    """Return how many processes of a group the kernel has killed for lack of memory; 0 if it does not count them."""
    for file in ("memory.events", "memory.oom_control"):
        if (folder / file).exists():
            lines = (line.split() for line in (folder / file).read_text().splitlines())
            return next((int(value) for key, value in lines if key == "oom_kill"), 0)
    return 0


def _remove_group(folder: Path, parent: Path) -> None:
    if folder.is_dir():
        for pid in (folder / "cgroup.procs").read_text().split():
            try:
                (parent / "cgroup.procs").write_text(pid)
            except OSError:
                continue  # the process has ended meanwhile
        folder.rmdir()


def _is_there(controller: str) -> bool:
    """Return whether the kernel has groups for this, of version 1 or of version 2."""
    if (MOUNTED / controller).is_dir():
        return True
    try:
        return controller in (MOUNTED / "cgroup.controllers").read_text().split()
    except OSError:
        return False


PROCESSOR = (Need("control groups for the processor", lambda: _is_there("cpu")), ROOT)
MEMORY = (Need("control groups for memory", lambda: _is_there("memory")), ROOT)
"""Requirements of the two limits."""
