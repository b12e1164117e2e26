"""Durable files, which a power cut leaves either unchanged or whole; secrets that only their owner can read; hashes."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp
from typing import Final

from pcmrs.errors import ConfigurationError

SECRET: Final = 0o600
"""Mode of a file that holds a secret."""
OWN: Final = 0o700
"""Mode of a folder that only its owner can enter."""
_OTHERS: Final = 0o077
"""Rights of all but the owner."""
_LONGEST: Final = 64 * 1024
"""Longest secret, bytes."""


def write_durably(path: Path, content: bytes, *, mode: int, masked: bool = True) -> None:
    """Write a file that gets its name only once its whole content is on the disk.

    Args:
        path: Path of the file.
        content: Whole content.
        mode: Mode of the file, such as `SECRET`.
        masked: False to give the file this mode whatever the mask of the process is.

    Raises:
        OSError: The file cannot be written.
    """
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            if not masked:
                os.fchmod(file.fileno(), mode)
            file.write(content)
        publish(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Write a folder that gets its name only once all its files are on the disk; nothing remains if that fails.

    Args:
        folder: Path of the folder. It must be new or empty.

    Yields:
        Folder to write the files into.

    Raises:
        ConfigurationError: The folder is not empty, or it is no folder.
        OSError: It cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        text = f"{folder} already exists and is not empty: name another folder, or move it away."
        raise ConfigurationError(text, folder=str(folder))
    folder.parent.mkdir(parents=True, exist_ok=True)
    part = Path(mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        yield part
        for path in part.iterdir():
            _sync(path)
        publish(part, folder)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def make_private(folder: Path) -> None:
    """Make a folder that only its owner can enter; an existing folder is closed to others.

    Raises:
        OSError: The folder cannot be made, or its mode cannot be changed.
    """
    folder.mkdir(mode=OWN, parents=True, exist_ok=True)
    if folder.stat().st_mode & _OTHERS:
        folder.chmod(OWN)


def keep_private() -> int:
    """Make all files and folders that this process and its children create private to their owner.

    Journal, recordings, exports and reports name the patient, whatever the mask of the shell is.

    Returns:
        The mask before, for `os.umask`.
    """
    return os.umask(_OTHERS)


def publish(part: Path, path: Path) -> None:
    """Give a file or folder its name once its whole content is on the disk.

    Args:
        part: Path of the written file, or of the folder, whose files are on the disk already.
        path: Path that it gets; in the same folder.

    Raises:
        OSError: The disk refuses.
    """
    _sync(part)
    part.replace(path)
    _sync(path.parent)


def sha256_of(path: Path) -> bytes:
    """Return the SHA-256 of a file, 32 bytes.

    Raises:
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read_secret(path: Path) -> bytes:
    """Read a secret, and check the mode of the opened file, which cannot be exchanged in between.

    Raises:
        ConfigurationError: Others than its owner can use the file.
        OSError: The file cannot be read.
    """
    with path.open("rb") as file:
        status = os.fstat(file.fileno())
        content = file.read(_LONGEST)
    mode = status.st_mode & 0o777
    if mode & 0o077 and not _is_credential(path, status):
        raise ConfigurationError(
            f"{path} has mode {mode:04o}: others than its owner may use this key. The limit is {SECRET:04o}: "
            f"chmod 600 {path}, and make a new key if someone may have copied it.",
            file=str(path),
            mode=f"{mode:04o}",
            limit=f"{SECRET:04o}",
        )
    return content


def _is_credential(path: Path, status: os.stat_result) -> bool:
    """Return True if a service manager provides the secret; its access list shows as the group's right to read."""
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    handed_over = status.st_uid == 0 and status.st_mode & 0o777 == 0o440
    return handed_over and folder is not None and path.parent == Path(folder)


def settle_on_disk(paths: Iterable[Path]) -> None:
    """Write files to the disk, and drop them from the page cache, so that the next read comes from the disk.

    After a failed fsync the kernel treats lost pages as written, so only data that is read from the disk is safe.

    Raises:
        OSError: An existing file cannot be opened, or still cannot be written.
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
