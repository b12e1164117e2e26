"""Opening of an archive by its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.archive import open_store
from pcmrs.errors import ArchiveError


def test_an_archive_is_made_only_on_request(database: str, folder: Path) -> None:
    for place in (str(folder), database):
        with pytest.raises(ArchiveError, match="pcmrs archive add"):
            open_store(place)
        open_store(place, make=True).close()
        open_store(place, make=True).close()
        open_store(place).close()
