"""The page of a cell: served only where it can be, with a token that only its owner can read and that stays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.console.settings import TOKEN, ConsoleSettings
from pcmrs.processes.starting import ProcessStarter, start_by_exec
from pcmrs.service.processes import console
from pcmrs.service.processes.console import is_served, open_console
from pcmrs.settings import CellSettings, Settings


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """Words of the children that were started."""
    found: list[tuple[str, ...]] = []

    async def open_child(_start: ProcessStarter, *words: str, **_: Any) -> None:
        found.append(words)

    monkeypatch.setattr(console, "open_child", open_child)
    return found


async def test_token_is_secret_and_stays_the_same(tmp_path: Path, started: list[tuple[str, ...]]) -> None:
    """Bookmarks of the page hold it."""
    settings, file = Settings(cell=CellSettings(folder=str(tmp_path))), tmp_path / TOKEN
    await open_console(start_by_exec, settings)
    token = file.read_bytes()
    assert len(token) >= 32
    assert file.stat().st_mode & 0o777 == 0o600
    await open_console(start_by_exec, settings)
    assert file.read_bytes() == token
    assert started == [("console", "--lifeline")] * 2


async def test_cells_have_different_tokens(tmp_path: Path, started: list[tuple[str, ...]]) -> None:
    tokens = set[bytes]()
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        await open_console(start_by_exec, Settings(cell=CellSettings(folder=str(tmp_path / name))))
        tokens.add((tmp_path / name / TOKEN).read_bytes())
    assert len(tokens) == len(started) == 2


async def test_folder_that_cannot_be_written_starts_nothing(tmp_path: Path, started: list[tuple[str, ...]]) -> None:
    with pytest.raises(OSError, match="gone"):
        await open_console(start_by_exec, Settings(cell=CellSettings(folder=str(tmp_path / "gone"))))
    assert started == []


@pytest.mark.parametrize("installed", [True, False])
@pytest.mark.parametrize("enabled", [True, False])
def test_page_needs_the_setting_and_the_package(
    monkeypatch: pytest.MonkeyPatch, enabled: bool, installed: bool
) -> None:
    monkeypatch.setattr(console, "find_spec", lambda name: object() if installed and name == "nicegui" else None)
    assert is_served(Settings(console=ConsoleSettings(enabled=enabled))) == (enabled and installed)
