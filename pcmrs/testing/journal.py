"""Files of a journal: writing them into a folder, and reading them back."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

NAME = "journal.sqlite"
HEAD = f"{NAME}.head"
KEY, PUBLIC_KEY = "journal.key", "journal.pub"


def place(files: Mapping[str, bytes], folder: Path) -> Path:
    """Write files into a new folder, and return the path of the journal in it.

    Args:
        files: Content of each file by name.
        folder: Folder to make.
    """
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    if KEY in files:
        (folder / KEY).chmod(0o600)
    return folder / NAME


def contents(folder: Path) -> dict[str, bytes]:
    """Return the content of all files in a folder by name, except SQLite's shared memory, which a reboot removes."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.endswith("-shm")}
