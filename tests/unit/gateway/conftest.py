"""An open gateway and its clients, and one whose peers sign."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.unit.gateway.open_cell import Cell, open_cell
from tests.unit.gateway.signed_room import Room, open_room, peer


@pytest.fixture
async def cell(tmp_path: Path) -> AsyncIterator[Cell]:
    async with open_cell(tmp_path) as opened:
        yield opened


@pytest.fixture
async def room(tmp_path: Path) -> AsyncIterator[Room]:
    async with open_room(tmp_path, {name: peer(tmp_path, name) for name in ("planner", "panel")}) as opened:
        yield opened
