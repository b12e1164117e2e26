"""Each session is recorded into its own file, named by its start in UTC and its session."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.processes.starting import ProcessStarter, start_by_exec
from pcmrs.recording.settings import FOLDER
from pcmrs.service.processes import recording
from pcmrs.service.processes.recording import start_recording
from pcmrs.settings import CellSettings, Settings
from pcmrs.testing.clock import EPOCH, ManualClock

SESSION = "0123456789abcdef"
KEY = b"k" * 32


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[tuple[tuple[str, ...], bytes]]:
    """Words and device keys of the children that were started."""
    found: list[tuple[tuple[str, ...], bytes]] = []

    async def open_child(_start: ProcessStarter, *words: str, device_key: bytes, **_: Any) -> None:
        found.append((words, device_key))

    monkeypatch.setattr(recording, "open_child", open_child)
    return found


async def test_a_session_has_its_own_file_in_the_cells_folder(
    tmp_path: Path, started: list[tuple[tuple[str, ...], bytes]]
) -> None:
    settings, clock = Settings(cell=CellSettings(folder=str(tmp_path))), ManualClock()
    assert clock.wall() == EPOCH + 100.0  # 2023-11-14 22:15:00 UTC
    await start_recording(start_by_exec, settings, SESSION, clock, KEY)
    await clock.advance(3600.0)
    await start_recording(start_by_exec, settings, "f" * 16, clock, KEY)
    (first, key), (second, _) = started
    assert first == (
        "record", str(tmp_path / FOLDER / "20231114T221500Z-01234567.mcap"), "--lifeline", "--session", SESSION,
    )  # fmt: skip
    assert second[1] == str(tmp_path / FOLDER / "20231114T231500Z-ffffffff.mcap")
    assert key == KEY
    assert (tmp_path / FOLDER).is_dir()


async def test_a_folder_that_cannot_be_made_is_an_error(
    tmp_path: Path, started: list[tuple[tuple[str, ...], bytes]]
) -> None:
    """The child is then given up; see `ChildProcess`."""
    (tmp_path / FOLDER).write_text("not a folder")
    with pytest.raises(FileExistsError):
        await start_recording(
            start_by_exec, Settings(cell=CellSettings(folder=str(tmp_path))), SESSION, ManualClock(), KEY
        )
    assert started == []
