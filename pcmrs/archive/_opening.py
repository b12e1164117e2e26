"""Opening of an archive by its place: a folder, or a PostgreSQL database."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from pcmrs.archive._store import ArchiveStore

POSTGRESQL: Final = ("postgresql://", "postgres://")
"""Beginnings of the address of a database."""


def open_store(place: str, *, make: bool = False) -> ArchiveStore:
    """Open an archive.

    Args:
        place: Folder, or address of a database (``postgresql://…``).
        make: True to make a new archive if there is none.

    Raises:
        ArchiveError: There is none, or it cannot be used.
    """
    if place.startswith(POSTGRESQL):
        from pcmrs.archive._postgresql import PostgresStore

        return PostgresStore(place, make=make)
    from pcmrs.archive._folder import FolderStore

    return FolderStore(Path(place), make=make)
