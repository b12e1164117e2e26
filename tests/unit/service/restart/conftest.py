"""A journal, and the configuration of a cell."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from pcmrs.journal import Journal
from pcmrs.settings import Settings, read_settings


@pytest.fixture
async def journal(tmp_path: Path) -> AsyncIterator[Journal]:
    opened = Journal.open(tmp_path / "ratms.sqlite", durable=False)
    yield opened
    await opened.close()


@pytest.fixture(scope="module")
def configured() -> Settings:
    return read_settings()
