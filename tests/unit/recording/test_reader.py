"""A recording that was cut or damaged anywhere: nothing whole is lost, no loss is silent."""

from __future__ import annotations

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

from pcmrs.errors import FileFormatError
from pcmrs.recording.reader import RecordingReader
from tests.support.trials import examples
from tests.unit.recording.recording_bench import MESSAGES

MAGIC = 8
BOMB = 1200 << 20


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
