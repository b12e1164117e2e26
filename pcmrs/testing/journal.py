"""Folders with the files of a journal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

NAME = "journal.sqlite"
HEAD = f"{NAME}.head"
KEY, PUBLIC_KEY = "journal.key", "journal.pub"


def place(files: Mapping[str, bytes], folder: Path) -> Path:
    """Write the files into a folder that is made; return the path of the journal."""
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    if KEY in files:
        (folder / KEY).chmod(0o600)
    return folder / NAME


def contents(folder: Path) -> dict[str, bytes]:
    """All files that outlive a process; SQLite's shared memory does, but is made anew after a reboot."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.endswith("-shm")}
