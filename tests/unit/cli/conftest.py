"""Fixtures of the tests of the command line."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from pcmrs.journal import Journal
from tests.unit.cli.journals import rows_of


@pytest.fixture
def journal_path(tmp_path: Path) -> Path:
    async def write() -> None:
        journal = Journal.open(tmp_path / "ratms.sqlite", durable=False)
        for number in range(4):
            await journal.append(rows_of(number))
        await journal.close()

    asyncio.run(write())
    return tmp_path / "ratms.sqlite"
