"""The folder of a cell: its format version, the lock of the program that writes it, and when a daemon may use it."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import closing, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from pcmrs.errors import ConfigurationError, JournalError
from pcmrs.files import SECRET, make_private, write_durably
from pcmrs.journal.schema import VERSION, open_for_reading, version_of
from pcmrs.messages import Message

FORMAT: Final = 2
"""Version of the folder that this program writes. Folders of version 1 have no `MARKER`."""
MARKER: Final = "cell.json"
"""Name of the file with the version of the folder."""
MANIFEST: Final = "backup.json"
"""Name of the file that makes a folder a backup."""
JOURNALS: Final = "*.sqlite"
"""Pattern of the first files of journals."""
_LOCK: Final = "lock"


class FolderFormat(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Content of the marker.

    Attributes:
        format: Version of the folder.
        program: Version of PCMRS that wrote the marker; empty if there is none.
    """

    format: int
    program: str = ""


def read_format(folder: Path) -> FolderFormat:
    """Return the version of a folder, which is 1 without a marker.

    Raises:
        ConfigurationError: The marker cannot be read.
    """
    path = folder / MARKER
    try:
        return msgspec.json.decode(path.read_bytes(), type=FolderFormat)
    except FileNotFoundError:
        return FolderFormat(format=1)
    except (OSError, msgspec.DecodeError) as error:
        text = f"{path} does not say which format this folder has: {error}. Put the file back from a backup."
        raise ConfigurationError(text, file=str(path)) from None


def write_format(folder: Path) -> None:
    """Mark a folder as one of this version. Raises `OSError`."""
    content = msgspec.json.encode(FolderFormat(format=FORMAT, program=version("pcmrs")))
    write_durably(folder / MARKER, content + b"\n", mode=SECRET)


def later_format(folder: Path) -> str:
    """Return why this version refuses a folder of a later one; empty if the folder is not.

    Raises:
        ConfigurationError: The marker cannot be read.
    """
    found = read_format(folder)
    if found.format <= FORMAT:
        return ""
    return (
        f"{folder} has format {found.format}, and this version of PCMRS reads 1 to {FORMAT}: PCMRS {found.program} "
        "wrote it. Use that version or a later one, or restore a backup that this version made."
    )


def not_a_cell(folder: Path) -> str:
    """Return why a folder is not the folder of one cell, which may be copied as such; empty if it is."""
    if (folder / MANIFEST).exists():
        return _is_backup(folder)
    # A folder above cells has its own lock: their daemons would not be noticed, nor the logs of their journals copied.
    below = sorted(
        path
        for pattern in (MARKER, JOURNALS)
        for path in folder.rglob(pattern)
        if path.parent != folder and not path.is_symlink()
    )
    if below:
        return (
            f"{folder} is not the folder of one cell: it has {below[0].relative_to(folder)} below it. Give the folder "
            f"of the cell, or move {below[0].parent} away."
        )
    if not (folder / MARKER).exists() and not any(folder.glob(JOURNALS)):
        return f"{folder} is not the folder of a cell: it has neither {MARKER} nor a journal. Give the cell.folder."
    return ""


def enter_folder(folder: Path) -> None:
    """Require that a daemon of this version may use a folder, and mark a new one.

    Args:
        folder: Folder of the cell, locked.

    Raises:
        ConfigurationError: It is a backup, a later version wrote it, or it has to be upgraded first.
        OSError: The marker cannot be written.
    """
    if (folder / MANIFEST).exists():
        raise ConfigurationError(_is_backup(folder), folder=str(folder))
    if later := later_format(folder):
        raise ConfigurationError(later, folder=str(folder))
    older = {path.name: found for path in sorted(folder.glob(JOURNALS)) if (found := _version(path)) < VERSION}
    if older:
        listed = ", ".join(f"{name} (format {found})" for name, found in older.items())
        raise ConfigurationError(
            f"{folder} was written by an earlier version of PCMRS: {listed}; this version writes format {VERSION}. See "
            f"`pcmrs upgrade --check {folder}`, then run `pcmrs upgrade {folder}`, which keeps the old folder.",
            folder=str(folder),
            journals=older,
        )
    if not (folder / MARKER).exists():
        write_format(folder)


def _is_backup(folder: Path) -> str:
    return f"{folder} is a backup, which stays as it is: `pcmrs restore {folder} FOLDER` makes a cell of it."


def _version(journal: Path) -> int:
    """Return the version of a journal; the present one if it cannot be read, which its own daemon reports."""
    try:
        with closing(open_for_reading(journal)) as connection:
            return version_of(connection)
    except JournalError:
        return VERSION


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of a cell's folder, which is made if there is none.

    Raises:
        ConfigurationError: A daemon or an upgrade holds it, or the folder cannot be used.
    """
    try:
        make_private(folder)
        lock = (folder / _LOCK).open("w")
    except OSError as error:
        raise ConfigurationError(f"{folder} cannot be used: {error.strerror}.", folder=str(folder)) from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            text = f"Another daemon runs this cell ({folder}): stop it, or choose another cell.name and ports."
            raise ConfigurationError(text, folder=str(folder)) from None
        yield


def is_temporary(name: str) -> bool:
    """Return True for a file that holds nothing by itself: the lock, SQLite's log, an unfinished write."""
    return name == _LOCK or name.endswith(("-wal", "-shm", ".part"))
