"""Files that a power cut leaves either as they were or whole, and secrets that nobody but their owner may read."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from pcmrs.errors import ConfigurationError

SECRET: Final = 0o600
"""Mode of a file that holds a secret."""
OWN: Final = 0o700
"""Mode of a folder that only its owner may look into."""
_LONGEST: Final = 64 * 1024


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


def make_private(folder: Path) -> None:
    """Make a folder that only its owner may look into; one that is there and open to others is closed to them.

    Raises:
        OSError: It cannot be made, or its rights cannot be changed.
    """
    folder.mkdir(mode=OWN, parents=True, exist_ok=True)
    if folder.stat().st_mode & 0o777 & ~OWN:
        folder.chmod(OWN)


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


def read_secret(path: Path) -> bytes:
    """Reads a secret, and looks at the file that it has read: nobody can exchange it in between.

    Raises:
        ConfigurationError: Others than its owner may use it.
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        status = os.fstat(file.fileno())
        content = file.read(_LONGEST)
    mode = status.st_mode & 0o777
    if mode & 0o077 and not _is_credential(path, status):
        raise ConfigurationError(
            f"{path} has mode {mode:04o}: others than its owner may use this key. The limit is {SECRET:04o}: "
            f"chmod 600 {path}, and make a new key if somebody may have copied it.",
            file=str(path),
            mode=f"{mode:04o}",
            limit=f"{SECRET:04o}",
        )
    return content


def _is_credential(path: Path, status: os.stat_result) -> bool:
    """Whether a service manager hands the secret over, by an access list that shows as the group's right to read."""
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    handed_over = status.st_uid == 0 and status.st_mode & 0o777 == 0o440
    return handed_over and folder is not None and path.parent == Path(folder)


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
