"""The numbered files of a recording, and the disk space that they may use together."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pcmrs.errors import ConfigurationError

SUFFIX = ".mcap"
_NUMBERED = re.compile(r"(?P<stem>.+)\.(?P<number>\d{4,})\.mcap")


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the files of a recording.

    Attributes:
        file_bytes: Approximate size at which the next file starts; None for no limit.
        file_s: Duration after which the next file starts, s; None for no limit.
        total_bytes: Size of all files together, beyond which the oldest are removed; None for no limit.
        keep_free_bytes: Free space on the disk below which the recording ends.
    """

    file_bytes: float | None = None
    file_s: float | None = None
    total_bytes: float | None = None
    keep_free_bytes: float = 0.0

    @property
    def numbered(self) -> bool:
        """True if there may be more than one file."""
        return self.file_bytes is not None or self.file_s is not None


def path_of(first: Path, number: int) -> Path:
    """Return the path of a numbered file: ``run.mcap`` gives ``run.0001.mcap``.

    Args:
        first: Name of the recording.
        number: Number of the file, from 1.
    """
    return first.with_name(f"{first.stem}.{number:04}{SUFFIX}")


def files_of(first: Path) -> list[Path]:
    """Return the files of a recording, oldest first: the file of that name, or the remaining numbered ones."""
    own = [path for path in first.parent.glob(f"*{SUFFIX}") if (found := _match(path)) and found["stem"] == first.stem]
    return [first] if first.exists() else sorted(own, key=_order)


def all_files(folder: Path) -> list[Path]:
    """Return all numbered files in a folder, oldest first if the names of recordings start with their date."""
    return sorted((path for path in folder.glob(f"*{SUFFIX}") if _match(path)), key=_order)


def session_files(folder: Path, sessions: Sequence[str]) -> list[Path]:
    """Return the files in a folder that a daemon recorded in these sessions, oldest first.

    Args:
        folder: Folder of the daemon's recordings.
        sessions: Ids of the sessions; a recording's name ends with the first 8 characters of one.
    """
    endings = tuple(f"-{session[:8]}" for session in sessions)
    return [path for path in all_files(folder) if path.name.partition(".")[0].endswith(endings)]


def recordings_in(folder: Path) -> dict[str, list[Path]]:
    """Return the recordings in a folder: name to files, oldest first; numbered files belong together."""
    found: dict[str, list[Path]] = {}
    for path in sorted(folder.glob(f"*{SUFFIX}"), key=_order):
        found.setdefault(_order(path)[0], []).append(path)
    return found


def check_new(first: Path) -> None:
    """Check the name of a new recording.

    Raises:
        ConfigurationError: It does not end in ``.mcap``, its folder is missing, or it exists.
    """
    if first.suffix != SUFFIX:
        raise ConfigurationError(f"{first} does not end in {SUFFIX}: give a name that does.", file=str(first))
    if not first.parent.is_dir():
        text = f"{first} cannot be written: there is no folder {first.parent}; create it first."
        raise ConfigurationError(text, file=str(first))
    if files := files_of(first):
        text = f"{files[0]} already exists: give another name, or move it away."
        raise ConfigurationError(text, file=str(files[0]))


def remove_oldest(files: Sequence[Path], limit: float, removed: Callable[[Path, int], None]) -> None:
    """Remove the oldest files until the others have at most `limit` bytes together; the last one stays.

    Args:
        files: Files, oldest first; the last one is being written.
        limit: Largest total size, bytes.
        removed: Callback for each removed file and its size, bytes.

    Raises:
        OSError: A file cannot be removed.
    """
    sizes = {path: path.stat().st_size for path in files}
    total = sum(sizes.values())
    for path in files[:-1]:
        if total <= limit:
            return
        path.unlink()
        total -= sizes[path]
        removed(path, sizes[path])


def _match(path: Path) -> re.Match[str] | None:
    return _NUMBERED.fullmatch(path.name)


def _order(path: Path) -> tuple[str, int]:
    found = _match(path)
    return (found["stem"], int(found["number"])) if found else (path.stem, 0)
