"""Journals in a folder of the test: new ones, whole ones, as a kill leaves them, and of earlier versions."""

from __future__ import annotations

import gzip
import tarfile
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from pcmrs.journal import Journal
from pcmrs.testing.journal import NAME, place
from tests.unit.journal.whole_journal import Sample, sample

FOLDER = Path(__file__).parent


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """First file of a journal that does not exist yet."""
    return tmp_path / "journal.sqlite"


@pytest.fixture(params=[True, False], ids=["durable", "inline"])
async def journal(request: pytest.FixtureRequest, path: Path) -> AsyncIterator[Journal]:
    journal = Journal.open(path, durable=request.param)
    yield journal
    await journal.close()


@pytest.fixture
def whole_path(tmp_path: Path) -> Path:
    """A journal that was closed in order; the folder ``copy`` is for a copy of it."""
    (tmp_path / "whole").mkdir()
    (tmp_path / "copy").mkdir()
    return place(sample(tmp_path / "whole", killed=False).files, tmp_path / "cell")


@pytest.fixture
def killed_journal(tmp_path: Path) -> Sample:
    (tmp_path / "whole").mkdir()
    return sample(tmp_path / "whole", killed=True)


@pytest.fixture
def killed_path(killed_journal: Sample, tmp_path: Path) -> Path:
    """A journal as a kill leaves it, with its log."""
    return place(killed_journal.files, tmp_path / "cell")


@pytest.fixture
def version_1(tmp_path: Path) -> Path:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / NAME).write_bytes(gzip.decompress((FOLDER / "version_1.sqlite.gz").read_bytes()))
    return tmp_path / "old" / NAME


@pytest.fixture
def version_2(tmp_path: Path) -> Path:
    with tarfile.open(FOLDER / "version_2.tar.gz") as archive:
        archive.extractall(tmp_path / "old", filter="data")
    (tmp_path / "old" / "journal.key").chmod(0o600)
    return tmp_path / "old" / NAME
