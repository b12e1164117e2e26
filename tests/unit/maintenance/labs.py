"""Labs that versions of PCMRS have written: authority, keys, calibrations, configuration and the folder of one cell."""

from __future__ import annotations

import json
import tarfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.unit.maintenance.write_folder import FOLDERS

VERSIONS = sorted(path.name.removesuffix(".tar.gz") for path in FOLDERS.glob("*.tar.gz"))
"""Names of the fixtures: ``first`` is the first released version."""


@dataclass(frozen=True)
class Lab:
    """An unpacked lab.

    Attributes:
        folder: Folder of all its files.
    """

    folder: Path

    @property
    def cell(self) -> Path:
        """Folder of its cell."""
        return self.folder / "cell"

    @property
    def journal(self) -> Path:
        """Journal of its cell."""
        return self.cell / "ratms.sqlite"

    @property
    def configuration(self) -> Path:
        """Configuration of its cell, for the folder in which the lab is now."""
        return self.folder / "cell.toml"

    def edit(self, name: str, edit: Callable[[bytes], bytes]) -> Path:
        """Change the content of a file, and return its path."""
        path = self.folder / name
        path.write_bytes(edit(path.read_bytes()))
        return path


def unpacked(version: str, folder: Path) -> Lab:
    """Unpack the lab that a version has written."""
    with tarfile.open(FOLDERS / f"{version}.tar.gz") as archive:
        archive.extractall(folder, filter="data")
    for path in (folder / "lab").rglob("*.key"):
        path.chmod(0o600)
    lab = Lab(folder / "lab")
    written_in = json.loads(lab.configuration.read_text().partition("key_file = ")[2].partition("\n")[0])
    lab.edit("cell.toml", lambda text: text.replace(str(Path(written_in).parent).encode(), str(lab.folder).encode()))
    return lab


def contents(folder: Path) -> dict[str, bytes]:
    """Return the content of all files by their paths, without the lock and what a reader of SQLite leaves."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "lock" and not path.name.endswith(("-shm", "-wal"))
    }
