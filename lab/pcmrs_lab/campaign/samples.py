"""Resources of a process, as the kernel reports them: memory, file descriptors, threads."""

from __future__ import annotations

import resource
from pathlib import Path

import msgspec


def process_state(pid: int) -> str:
    """Return the state of a process: R runs, S sleeps, T is stopped."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def descriptors(pid: int) -> int:
    """Return the number of open files and sockets of a process."""
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))


class ResourceSample(msgspec.Struct, frozen=True):
    """Resources of one process at one time.

    Attributes:
        memory: Resident memory, bytes.
        descriptors: Number of open files and sockets.
        threads: Number of threads.
    """

    memory: int
    descriptors: int
    threads: int


def sample(pid: int) -> ResourceSample:
    """Return the present resources of a process; raise `OSError` if it has ended."""
    folder = Path(f"/proc/{pid}")
    pages = int((folder / "statm").read_text().split()[1])
    return ResourceSample(
        memory=pages * resource.getpagesize(),
        descriptors=_count(folder / "fd"),
        threads=_count(folder / "task"),
    )


def _count(folder: Path) -> int:
    return sum(1 for _ in folder.iterdir())


def slope(times: list[float], values: list[float]) -> tuple[float, float]:
    """Return slope of values over time, 1/s, and its standard error, by least squares; 0, 0 for fewer than 3.

    Args:
        times: Times, s.
        values: Values at these times.
    """
    count = len(times)
    if count < 3:
        return 0.0, 0.0
    middle, level = sum(times) / count, sum(values) / count
    spread = sum((time - middle) ** 2 for time in times)
    found = sum((time - middle) * (value - level) for time, value in zip(times, values, strict=True)) / spread
    rest = sum((value - level - found * (time - middle)) ** 2 for time, value in zip(times, values, strict=True))
    return found, float((rest / (count - 2) / spread) ** 0.5)
