"""Files beside the journal, written so that a power cut leaves either nothing or all of them."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path


def write_durably(path: Path, content: bytes, *, mode: int) -> None:
    """Writes a whole file under its name only when the disk has it. Raises `OSError`."""
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
        publish(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def publish(part: Path, path: Path) -> None:
    """Gives a file its name once the disk has it as a whole. Raises `OSError`."""
    _sync(part)
    part.replace(path)
    _sync(path.parent)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def settle_on_disk(paths: Iterable[Path]) -> None:
    """Has the disk take what it has not, and the next read of these files come from the disk.

    After a failed fsync the kernel takes what was lost for written: only what is read from the disk is there.

    Raises:
        OSError: A file that is there cannot be opened, or still not be written.
    """
    for path in paths:
        if not path.exists():
            continue
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
        finally:
            os.close(descriptor)
