"""Recordings are read once for all pages, and one that cannot be read says why."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest
from nicegui import core

from pcmrs.bus.codec import pack
from pcmrs.console import _recordings as module
from pcmrs.console._recordings import Recordings
from pcmrs.console.playback import LoadedRecording, load_recording
from pcmrs.recording.file import RecordingFile, Topics


@pytest.fixture(autouse=True)
async def running(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(core, "loop", asyncio.get_running_loop())


def write(path: Path) -> None:
    topics = Topics()
    file = RecordingFile(path, topics, {"cell": "lab/cell1"})
    for number in range(2):
        topics.write_raw(
            "state/event", float(number), pack({"device": "robot", "code": "c", "text": ""}), number * 10**9
        )
    file.close()


async def read(recordings: Recordings, name: str) -> LoadedRecording | None:
    """The recording, or nothing when it is known that it cannot be read."""
    async with asyncio.timeout(20.0):
        while (found := recordings.get(name)) is None:
            await asyncio.sleep(0.01)
            if recordings.trouble:
                return None
    return found


async def test_names_are_newest_first_and_none_without_a_folder(tmp_path: Path) -> None:
    for name in ("20260102T000000Z-b", "20260101T000000Z-a", "20260103T000000Z-c"):
        write(tmp_path / f"{name}.mcap")
    assert [name[-1] for name in Recordings(tmp_path).names()] == ["c", "b", "a"]
    assert Recordings(None).names() == []


async def test_a_recording_is_read_once_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[list[Path]] = []

    def load(files: list[Path], progress: Callable[[float], None]) -> LoadedRecording:
        calls.append(files)
        return load_recording(files, progress)

    monkeypatch.setattr(module, "load_recording", load)
    for name in ("one", "two"):
        write(tmp_path / f"{name}.mcap")
    recordings = Recordings(tmp_path)
    assert recordings.get("one") is None, "it takes a while"
    first = await read(recordings, "one")
    assert first is not None
    assert recordings.is_read
    assert 0.0 < recordings.progress <= 1.0
    assert recordings.get("one") is first
    assert len(calls) == 1
    assert await read(recordings, "two") is not first, "only one is kept"
    assert len(calls) == 2


async def test_what_cannot_be_read_says_why_and_is_tried_again(tmp_path: Path) -> None:
    (tmp_path / "bad.mcap").write_bytes(b"no recording")
    recordings = Recordings(tmp_path)
    assert await read(recordings, "bad") is None
    assert "bad.mcap" in recordings.trouble
    assert not recordings.is_read
    assert await read(recordings, "none") is None
    assert recordings.trouble == "There is no recording none."
    (tmp_path / "bad.mcap").unlink()
    write(tmp_path / "bad.mcap")
    assert recordings.get("bad") is None
    assert recordings.trouble == ""
    assert await read(recordings, "bad") is not None
