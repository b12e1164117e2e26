"""A journal of one cell, an archive in a folder, and one in PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import psycopg
import pytest

from pcmrs.archive import ArchiveStore
from tests.unit.archive.archives import commands, config, opened, write
from tests.unit.archive.postgres_server import running_server


@pytest.fixture
def journal_path(tmp_path: Path) -> Path:
    """A journal of ten rows."""
    return write(tmp_path / "cell" / "ratms.sqlite", [config(), *commands(3)])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "archive"


@pytest.fixture(scope="session")
def server() -> Iterator[str]:
    """Address of a PostgreSQL server of this test run."""
    with running_server() as address:
        yield address


@pytest.fixture
def database(server: str) -> Iterator[str]:
    """Address of a database without an archive."""
    yield server
    with psycopg.connect(server, autocommit=True) as connection:
        connection.execute("DROP SCHEMA IF EXISTS pcmrs_archive CASCADE")


@pytest.fixture(params=["folder", "postgresql"])
def store(request: pytest.FixtureRequest, folder: Path) -> Iterator[ArchiveStore]:
    """An empty archive of each kind."""
    place = folder if request.param == "folder" else request.getfixturevalue("database")
    with opened(place) as made:
        yield made
