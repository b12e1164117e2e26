"""Of a recording only what is asked for is played."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from pcmrs.bus import Bus, BusSettings
from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError, FileFormatError
from pcmrs.recording.playback import Excerpt, PlaybackPublisher, read_cell_name
from pcmrs.testing.daemon import free_port
from tests.unit.recording.recording_bench import MESSAGES


async def test_of_a_recording_only_what_is_asked_for_is_played(
    whole: tuple[bytes, list[bytes]], tmp_path: Path
) -> None:
    file, cut = tmp_path / "run.mcap", tmp_path / "cut.mcap"
    file.write_bytes(whole[0])
    cut.write_bytes(whole[0][: len(whole[0]) // 2])
    router = BusSettings(mode="router", endpoint=f"tcp/127.0.0.1:{free_port()}")
    bus = await Bus.open(router)
    player = await PlaybackPublisher.open(router.endpoint, "x", SystemClock())
    try:
        for excerpt, count in (
            (Excerpt(rate=10.0), MESSAGES),
            (Excerpt(rate=10.0, topics=("state/joints",)), MESSAGES // 2),
            (Excerpt(rate=10.0, topics=("cmd/**",)), 0),
            (Excerpt(begin=0.0495, end=0.1005), 51),
            (Excerpt(begin=9.0), 0),
        ):
            played = await player.play([file], excerpt, lambda *_: None)
            assert (played.prefix, played.messages, played.damage) == ("pcmrs/replay/x", count, [])
        damaged = await player.play([cut], Excerpt(rate=100.0), lambda *_: None)
        assert 0 < damaged.messages < MESSAGES
        assert 0 < damaged.lost_bytes < len(whole[0]) // 2
        assert str(cut) in damaged.damage[0]
        with pytest.raises(ConfigurationError, match="key expression"):
            await player.play([file], Excerpt(topics=("a//b",)), lambda *_: None)
    finally:
        await player.close()
        await bus.close()
    assert read_cell_name(cut) == "x"


def test_a_recording_of_another_program_has_no_cell(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        writer.finish()
    with pytest.raises(FileFormatError, match="does not name its cell"):
        read_cell_name(path)
