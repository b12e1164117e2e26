"""A small ext4 disk of a fault's own, in a file: it can be full, fail, lose its power and come back."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.needs import ROOT, Need, program
from pcmrs_lab.campaign.sham import bring_about, is_sham
from pcmrs_lab.campaign.tools import tool

NEEDS = (
    *map(program, ("mkfs.ext4", "mount", "umount")),
    Need("loop devices", lambda: Path("/dev/loop-control").exists()),
    ROOT,
)

MEBIBYTES = 24
"""Size of the disk; the smallest that ext4 gives a journal of its own."""

SHUTDOWN = 0x8004587D
"""EXT4_IOC_SHUTDOWN, Linux, fs/ext4/ext4.h: the file system is cut off from its disk."""
WITHOUT_FLUSHING = 2
"""EXT4_GOING_FLAGS_NOLOGFLUSH: what no fsync has waited for is lost, as in a power cut."""

RESERVE, PROBE = "reserve", "probe"


@dataclass(frozen=True, slots=True)
class LoopDisk:
    """A mounted disk.

    Attributes:
        path: Where it is mounted.
        image: The file that holds it.
    """

    path: Path
    image: Path

    def fill(self, leaving: int = 0) -> None:
        """Takes all the space that is left but for some bytes; `release` gives it back; nothing in a sham campaign."""
        if is_sham():
            return
        with (self.path / RESERVE).open("wb", buffering=0) as reserve:
            for size in (1 << 20, 1 << 12, 1):
                with suppress(OSError):
                    while reserve.write(bytes(size)):
                        continue
            reserve.truncate(max(0, reserve.tell() - leaving))
            with suppress(OSError):
                os.fsync(reserve.fileno())

    def release(self) -> None:
        """Gives back what `fill` has taken."""
        (self.path / RESERVE).unlink(missing_ok=True)
        folder = os.open(self.path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def cut_power(self) -> None:
        """Nothing reaches the disk any more, and what was not synchronised never will; until `power_on`."""
        folder = os.open(self.path, os.O_RDONLY)
        try:
            bring_about(lambda: fcntl.ioctl(folder, SHUTDOWN, struct.pack("I", WITHOUT_FLUSHING)))
        finally:
            os.close(folder)

    async def power_on(self) -> None:
        """Mounts the disk anew, as a machine that starts does; nobody may have files of it open."""
        await _unmounted(self.path)
        await tool(["mount", "-o", "loop,errors=remount-ro", str(self.image), str(self.path)])

    async def make_read_only(self) -> None:
        """The file system goes read-only by itself, as it does when it finds itself damaged."""
        if not is_sham():
            await tool(["mount", "-o", "remount,abort", str(self.path)])

    def error(self) -> str:
        """What another program that writes to the disk is told, such as ``ENOSPC``; empty where it can write."""
        file = self.path / PROBE
        try:
            with file.open("wb", buffering=0) as probe:
                probe.write(bytes(1 << 12))
                os.fsync(probe.fileno())
        except OSError as error:
            return errno.errorcode.get(error.errno or 0, str(error))
        finally:
            with suppress(OSError):
                file.unlink()
        return ""

    def taken(self) -> float:
        """Share of the disk's space that nobody can have any more, as the kernel counts it."""
        counted = os.statvfs(self.path)
        return 1.0 - counted.f_bavail / counted.f_blocks


@asynccontextmanager
async def loop_disk(folder: Path) -> AsyncIterator[LoopDisk]:
    """Makes a disk in `folder`, mounts it, and takes it away with the context.

    Raises:
        NotRun: This machine does not let this process mount one.
    """
    disk = _prepared(folder)
    await tool(["mkfs.ext4", "-q", "-O", "has_journal", "-m", "0", str(disk.image)])
    await tool(["mount", "-o", "loop,errors=remount-ro", str(disk.image), str(disk.path)])
    try:
        yield disk
    finally:
        await _unmounted(disk.path)


def _prepared(folder: Path) -> LoopDisk:
    disk = LoopDisk(folder / "disk", folder / "disk.ext4")
    disk.path.mkdir()
    with disk.image.open("wb") as image:
        image.truncate(MEBIBYTES << 20)
    return disk


async def _unmounted(path: Path) -> None:
    """A process that is about to end may hold the disk for a while."""
    for _ in range(100):
        with suppress(NotRun):
            await tool(["umount", str(path)])
            return
        await asyncio.sleep(0.1)
    await tool(["umount", "-l", str(path)])
