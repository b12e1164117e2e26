"""A recording that was cut anywhere, damaged, or whose writer was killed: nothing whole is lost, no loss is silent."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import Writer

from pcmrs.bus import Bus, BusSettings
from pcmrs.bus.codec import pack
from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError, FileFormatError
from pcmrs.recording.file import RecordingFile, Topics
from pcmrs.recording.playback import Excerpt, PlaybackPublisher, read_cell_name
from pcmrs.recording.raw import encode
from pcmrs.recording.reader import RecordingReader
from pcmrs.recording.repair import repair
from pcmrs.recording.subscriber import RawSample
from pcmrs.recording.views import RecordingViews
from pcmrs.testing.daemon import free_port
from tests.support.trials import examples
from tests.unit.recording.recording_bench import ARM, MOUNTING, decoded, joints, pose

MAGIC = 8
MESSAGES = 160
BOMB = 1200 << 20
BEGUN = 10**18
SPACING = 10**6
"""ns since 1970, and between two messages."""


def written(path: Path) -> list[bytes]:
    """Writes a recording of a few chunks; returns the payloads in order."""
    topics, views, noise = Topics(), RecordingViews(ARM, MOUNTING, 1.0), random.Random(1)
    file = RecordingFile(path, topics, {"cell": "x"})
    payloads = []
    for number in range(MESSAGES):
        message = joints([noise.random() for _ in ARM.joints]) if number % 2 else pose("coil", number)
        heard = RawSample("state/joints" if number % 2 else "state/pose/coil", pack(message), float(number))
        topics.write_raw(heard.key, heard.at, heard.payload, BEGUN + number * SPACING)
        for topic, view in views.of(heard, BEGUN + number * SPACING):
            topics.write(topic, view, BEGUN + number * SPACING)
        payloads.append(heard.payload)
    file.close()
    assert file.error is None
    return payloads


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[bytes]]:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    payloads = written(path)
    return path.read_bytes(), payloads


def saved(content: bytes, folder: Path) -> tuple[list[bytes], RecordingReader]:
    """The messages of the bus that can be read from a file with this content."""
    path = folder / "damaged.mcap"
    path.write_bytes(content)
    reading = RecordingReader(path)
    return [heard.payload for _, heard in reading.bus_messages()], reading


@pytest.mark.parametrize("step", [1009, pytest.param(1, marks=[pytest.mark.nightly, pytest.mark.timeout(1800)])])
def test_file_cut_anywhere_gives_its_first_messages_and_the_loss(
    whole: tuple[bytes, list[bytes]], tmp_path: Path, step: int
) -> None:
    """More bytes never give fewer messages."""
    content, payloads = whole
    before = 0
    for cut in [*range(MAGIC, len(content) - 1, step), len(content) - 1]:
        found, reading = saved(content[:cut], tmp_path)
        assert found == payloads[: len(found)]
        assert len(found) >= before
        assert not reading.complete
        assert reading.damage
        assert reading.whole <= cut
        before = len(found)
    assert before == MESSAGES
    found, reading = saved(content, tmp_path)
    assert (found, reading.complete, reading.damage, reading.whole) == (payloads, True, "", len(content))


@examples(40)
@given(st.data())
def test_a_flipped_bit_never_changes_a_message(whole: tuple[bytes, list[bytes]], data: st.DataObject) -> None:
    """Chunks have checksums; bytes outside them hold no messages."""
    content, payloads = whole
    at = data.draw(st.integers(MAGIC, len(content) - 1))
    flipped = bytearray(content)
    flipped[at] ^= 1 << data.draw(st.integers(0, 7))
    with tempfile.TemporaryDirectory() as folder:
        try:
            found, _ = saved(bytes(flipped), Path(folder))
        except FileFormatError:
            return
    assert found == payloads[: len(found)]


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


def write_chunk(path: Path, compression: str, data: bytes, size: int) -> None:
    """A file of one chunk, which says of itself that it has `size` bytes when decompressed."""
    chunk = Chunk(
        compression=compression,
        data=data,
        uncompressed_size=size,
        uncompressed_crc=0,
        message_start_time=0,
        message_end_time=0,
    )
    record: Any = RecordBuilder()
    with path.open("wb") as file:
        Writer(file).start()
        chunk.write(record)
        file.write(record.end())


@pytest.mark.parametrize("frame_says_its_size", [True, False])
def test_a_chunk_that_would_fill_the_memory_is_damage(tmp_path: Path, frame_says_its_size: bool) -> None:
    """40 kB of zstd are 1.2 GB of zeros; they are refused by what they say of themselves."""
    path, mebibyte = tmp_path / "run.mcap", 1 << 20
    packer = zstandard.ZstdCompressor(write_content_size=frame_says_its_size)
    packing = packer.compressobj(size=BOMB if frame_says_its_size else -1)
    packed = b"".join(packing.compress(bytes(mebibyte)) for _ in range(BOMB // mebibyte)) + packing.flush()
    write_chunk(path, "zstd", packed, size=16 if frame_says_its_size else BOMB)
    reading = RecordingReader(path)
    assert [type(record).__name__ for record in reading.records()] == ["Header"]
    assert not reading.complete
    assert f"{BOMB} bytes when decompressed" in reading.damage


def test_chunk_in_an_unknown_compression_is_damage(tmp_path: Path) -> None:
    write_chunk(tmp_path / "run.mcap", "lz4", b"", size=0)
    reading = RecordingReader(tmp_path / "run.mcap")
    assert [type(record).__name__ for record in reading.records()] == ["Header"]
    assert "'lz4'" in reading.damage


def test_killed_writer_loses_only_data_after_its_last_flush(tmp_path: Path) -> None:
    program = f"""
import os, signal, sys
sys.path[:0] = {sys.path!r}
from pathlib import Path
from pcmrs.recording.file import RecordingFile, Topics
topics = Topics()
file = RecordingFile(Path({str(tmp_path / "run.mcap")!r}), topics, {{"cell": "x"}})
for number in range(1000):
    topics.write_raw("state/x", float(number), b"%04d" % number + os.urandom(60), number)
    if number == 899:
        file.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=60, check=False)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    reading = RecordingReader(tmp_path / "run.mcap")
    numbers = [int(heard.payload[:4]) for _, heard in reading.bus_messages()]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= 900
    assert not reading.complete


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
