"""Small ext4 disk in a file for one fault: it can be full, fail, lose its power and come back."""

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

from pcmrs.testing.needs import ROOT, Need, program
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.tools import tool

NEEDS = (
    *map(program, ("mkfs.ext4", "mount", "umount")),
    Need("loop devices", lambda: Path("/dev/loop-control").exists()),
    ROOT,
)

MEBIBYTES = 24
"""Size of the disk; the smallest for which mkfs makes an ext4 journal."""

SHUTDOWN = 0x8004587D
"""EXT4_IOC_SHUTDOWN, Linux, fs/ext4/ext4.h: the file system is cut off from its disk."""
WITHOUT_FLUSHING = 2
"""EXT4_GOING_FLAGS_NOLOGFLUSH: data that was not synchronised is lost, as in a power cut."""

RESERVE, PROBE = "reserve", "probe"


@dataclass(frozen=True, slots=True)
class LoopDisk:
    """Mounted disk.

    Attributes:
        path: Mount point.
        image: File with the file system.
    """

    path: Path
    image: Path

    def fill(self, leaving: int = 0) -> None:
        """Take all free space except some bytes, until `release`; do nothing in a sham campaign.

        Args:
            leaving: Number of bytes that stay free.
        """
        if is_sham():
            return
        with (self.path / RESERVE).open("wb", buffering=0) as reserve:
            # Smaller writes fill the space that a larger one does not fit into.
            for size in (1 << 20, 1 << 12, 1):
                with suppress(OSError):
                    while reserve.write(bytes(size)):
                        continue
            reserve.truncate(max(0, reserve.tell() - leaving))
            with suppress(OSError):
                os.fsync(reserve.fileno())

    def release(self) -> None:
        """Free the space that `fill` has taken."""
        (self.path / RESERVE).unlink(missing_ok=True)
        folder = os.open(self.path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def cut_power(self) -> None:
        """Cut the disk off until `power_on`: no write reaches it, and data that was not synchronised is lost."""
        folder = os.open(self.path, os.O_RDONLY)
        try:
            inject_unless_sham(lambda: fcntl.ioctl(folder, SHUTDOWN, struct.pack("I", WITHOUT_FLUSHING)))
        finally:
            os.close(folder)

    async def power_on(self) -> None:
        """Mount the disk again, as a starting machine does; no program may have files of it open."""
        await _unmount(self.path)
        await tool(["mount", "-o", "loop,errors=remount-ro", str(self.image), str(self.path)])

    async def make_read_only(self) -> None:
        """Make the file system read-only by itself, as if it had found itself damaged."""
        if not is_sham():
            await tool(["mount", "-o", "remount,abort", str(self.path)])

    def error(self) -> str:
        """Return the error of another program that writes to the disk, such as ``ENOSPC``; empty if it can write."""
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

    def used_share(self) -> float:
        """Return the share of the disk's space that is not available, as the kernel counts it."""
        counted = os.statvfs(self.path)
        return 1.0 - counted.f_bavail / counted.f_blocks


@asynccontextmanager
async def loop_disk(folder: Path) -> AsyncIterator[LoopDisk]:
    """Make a disk in `folder`, mount it, and remove it at the end of the context.

    Raises:
        NotRun: This machine does not permit mounting.
    """
    disk = _create(folder)
    # No blocks are reserved for root (-m 0), so that root and other users have the same free space.
    await tool(["mkfs.ext4", "-q", "-O", "has_journal", "-m", "0", str(disk.image)])
    await tool(["mount", "-o", "loop,errors=remount-ro", str(disk.image), str(disk.path)])
    try:
        yield disk
    finally:
        await _unmount(disk.path)


def _create(folder: Path) -> LoopDisk:
    disk = LoopDisk(folder / "disk", folder / "disk.ext4")
    disk.path.mkdir()
    with disk.image.open("wb") as image:
        image.truncate(MEBIBYTES << 20)
    return disk


async def _unmount(path: Path) -> None:
    """Unmount the disk; a process that is about to end may hold it for a while."""
    for _ in range(100):
        with suppress(NotRun):
            await tool(["umount", str(path)])
            return
        await asyncio.sleep(0.1)
    await tool(["umount", "-l", str(path)])
