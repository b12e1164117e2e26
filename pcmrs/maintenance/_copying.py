"""Copy of a cell's folder: journals by SQLite's backup interface, all other files byte by byte."""

from __future__ import annotations

import ctypes
import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from pcmrs.errors import ConfigurationError
from pcmrs.journal import copy_journal, journal_files
from pcmrs.journal.head import head_path
from pcmrs.maintenance._folder import JOURNALS, is_temporary

_CURRENT_DIRECTORY: Final = -100
_EXCHANGE: Final = 2
"""Flag of renameat2(2), see `linux/fs.h`."""


def copy_folder(
    source: Path, target: Path, *, leave_out: frozenset[str] = frozenset(), link: str = "", symbolic: bool = False
) -> None:
    """Copy a cell's folder; a daemon may be writing it.

    Journals are copied first: a counter of a signed peer is then never older than the journal, so that no command that
    the journal has is accepted again.

    Args:
        source: Folder of the cell.
        target: Empty folder.
        leave_out: Names of files and folders at the top that are not copied.
        link: Name of a folder at the top whose files are hard links if the file system allows it: large files that
            nobody writes any more.
        symbolic: True to make symbolic links with the same targets, for a copy beside the source. A linked journal is
            copied all the same.

    Raises:
        JournalError: A journal cannot be read, or is written too fast to be copied.
        OSError: A file cannot be read or written.
    """
    journals = sorted(source.glob(JOURNALS))
    copied: set[Path] = set()
    for journal in journals:
        copy_journal(journal, target / journal.name)
        copied |= {*journal_files(journal), head_path(journal)}
    for path in files_in(source):
        top = path.relative_to(source).parts[0]
        if path in copied or top in leave_out:
            continue
        place = target / path.relative_to(source)
        place.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        _copy(path, place, link=bool(link) and top == link)
    if symbolic:
        _copy_links(source, target)


def files_in(folder: Path) -> Iterator[Path]:
    """Yield all files in a folder and below, in the order of their names, without temporary ones and without links."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink() and not is_temporary(path.name):
            yield path


def links_in(folder: Path) -> list[str]:
    """Return the names of symbolic links in a folder and below, which no backup holds."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_symlink())


def check_room(target: Path, needed: int) -> None:
    """Require free space on the disk of a new folder.

    Args:
        target: The new folder.
        needed: Bytes that will be written.

    Raises:
        ConfigurationError: There is too little.
    """
    existing = next(parent for parent in target.absolute().parents if parent.exists())
    free = shutil.disk_usage(existing).free
    if needed > free:
        text = (
            f"{target} needs {needed / 1e6:.1f} MB, and {free / 1e6:.1f} MB are free: make room, or give another disk."
        )
        raise ConfigurationError(text, needed=needed, free=free)


def size_of(folder: Path, leave_out: frozenset[str] = frozenset()) -> int:
    """Return the size of the files in a folder, bytes.

    Args:
        folder: The folder.
        leave_out: Names at the top that do not count.
    """
    return sum(path.stat().st_size for path in files_in(folder) if path.relative_to(folder).parts[0] not in leave_out)


def unfinished(folder: Path) -> Path:
    """Return the folder beside one in which its copy is made: a name that no person gives, since it may be removed."""
    return folder.with_name(f".{folder.name}.pcmrs-unfinished")


def make_new(folder: Path) -> None:
    """Make a private folder for an unfinished copy; an earlier unfinished one is removed. Raises `OSError`."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(mode=0o700)


def settle(folder: Path) -> None:
    """Write all files and folders of a copy to the disk. Raises `OSError`."""
    for path in [folder, *folder.rglob("*")]:
        if not path.is_symlink() and (path.is_dir() or path.is_file()):
            sync(path)


def sync(path: Path) -> None:
    """Write a file or folder to the disk. Raises `OSError`."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def exchange(one: Path, other: Path) -> None:
    """Exchange the names of two folders in one step, which a crash leaves done or not done.

    Args:
        one: Path of a folder.
        other: Path of another folder in the same file system.

    Raises:
        ConfigurationError: The file system cannot do it, or one of them is a mount point.
    """
    # Python has no name for renameat2(2). Two renames would leave a moment without the folder.
    libc = ctypes.CDLL(None, use_errno=True)
    status = libc.renameat2(_CURRENT_DIRECTORY, os.fsencode(one), _CURRENT_DIRECTORY, os.fsencode(other), _EXCHANGE)
    if status != 0:
        reason = os.strerror(ctypes.get_errno())
        text = (
            f"{one} and {other} cannot change places: {reason}. Move {one} into a folder of a local disk, and repeat."
        )
        raise ConfigurationError(text, folder=str(one))
    sync(one.parent)


def _copy_links(source: Path, target: Path) -> None:
    for name in links_in(source):
        place = target / name
        if is_temporary(place.name) or os.path.lexists(place):  # the latter has the content of a linked journal
            continue
        place.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        place.symlink_to((source / name).readlink())


def _copy(path: Path, place: Path, *, link: bool) -> None:
    try:
        if link:
            with suppress(OSError):  # a file system without links, or another one: copy
                os.link(path, place)
                return
        shutil.copy2(path, place)
    except FileNotFoundError:
        if path.exists():
            raise
        # The daemon has removed it since, for example its oldest recording.
