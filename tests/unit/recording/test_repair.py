"""A repaired recording is whole, and says what was lost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from pcmrs.errors import ConfigurationError, FileFormatError
from pcmrs.recording.file import RecordingFile, Topics
from pcmrs.recording.raw import encode
from pcmrs.recording.reader import RecordingReader
from pcmrs.recording.repair import repair
from tests.unit.recording.recording_bench import BEGUN, MESSAGES, decoded


def test_a_repaired_file_is_whole_for_another_reader(whole: tuple[bytes, list[bytes]], tmp_path: Path) -> None:
    content, payloads = whole
    damaged, mended = tmp_path / "damaged.mcap", tmp_path / "mended.mcap"
    damaged.write_bytes(content[: len(content) // 2])
    report = repair(damaged, mended)
    assert not report.complete
    assert report.kept_bytes + report.lost_bytes == len(content) // 2
    messages = decoded(mended)  # refuses a file without its end
    assert report.messages == len(messages)
    on_bus = [each.payload for topic, _, _, each in messages if topic.startswith("bus/")]
    assert on_bus == payloads[: len(on_bus)]
    assert len(on_bus) > MESSAGES // 10
    assert report.until == max(log_time for _, _, log_time, _ in messages) / 1e9
    assert RecordingReader(mended).size == mended.stat().st_size
    with pytest.raises(ConfigurationError, match="already exists"):
        repair(damaged, mended)
    with pytest.raises(FileFormatError, match="not an MCAP file"):
        repair(Path(__file__), tmp_path / "other.mcap")
    assert not (tmp_path / "other.mcap").exists()


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("schema", [0, 9])
def test_undeclared_channel_or_schema_is_damage(tmp_path: Path, schema: int, chunked: bool) -> None:
    """Found by `fuzz.recordings`: a repair ended with a `KeyError`, and left half a file."""
    damaged = tmp_path / "damaged.mcap"
    with damaged.open("wb") as file:
        writer: Any = Writer(file, use_chunking=chunked, chunk_size=1)
        writer.start()
        known = writer.register_channel("bus/state/joints", "protobuf", 0)
        writer.add_message(known, BEGUN, encode(1.0, b"known"), BEGUN)
        unknown = writer.register_channel("bus/state/fsm", "protobuf", 9) if schema else known + 1
        writer.add_message(unknown, BEGUN, encode(1.0, b"unknown"), BEGUN)
        writer.finish()
    report = repair(damaged, tmp_path / "mended.mcap")
    assert (report.complete, report.messages) == (False, 1)
    assert "declared" in report.damage
    assert [heard.payload for _, heard in RecordingReader(damaged).bus_messages()] == [b"known"]
    assert RecordingReader(tmp_path / "mended.mcap").size


def plain(found: tuple[str, str, int, Any]) -> tuple[Any, ...]:
    """A message as bytes: each file has its own classes of messages."""
    *what, content = found
    return (*what, content.SerializeToString() if hasattr(content, "SerializeToString") else content)


def test_a_whole_file_loses_nothing(whole: tuple[bytes, list[bytes]], tmp_path: Path) -> None:
    source, copy = tmp_path / "whole.mcap", tmp_path / "copy.mcap"
    source.write_bytes(whole[0])
    report = repair(source, copy)
    assert (report.complete, report.damage, report.lost_bytes) == (True, "", 0)
    assert report.kept_bytes == len(whole[0])
    assert [*map(plain, decoded(copy))] == [*map(plain, decoded(source))]
    assert RecordingReader(copy).origin == RecordingReader(source).origin
    assert source.read_bytes() == whole[0]


def test_a_file_without_messages_has_no_last_time(tmp_path: Path) -> None:
    source = tmp_path / "empty.mcap"
    RecordingFile(source, Topics(), {"cell": "x"}).close()
    report = repair(source, tmp_path / "copy.mcap")
    assert (report.complete, report.messages, report.until) == (True, 0, None)
