"""Reader of MCAP files; of one that was cut or damaged, everything up to the first incomplete record."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

import zstandard
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from pcmrs.bus.codec import MAX_BYTES
from pcmrs.errors import FileFormatError
from pcmrs.recording import raw
from pcmrs.recording.file import FORMAT, FORMAT_KEY, METADATA
from pcmrs.recording.subscriber import RawSample

__all__ = ["RecordingReader", "check_format", "recording_format"]

LARGEST_CHUNK: Final = 2 * MAX_BYTES
"""Largest size of a decompressed chunk, bytes: the largest message of the bus and its view, after `CHUNK`, fit in."""

_MAGIC = b"\x89MCAP0\r\n"


class RecordingReader:
    """One pass over a file.

    Args:
        path: MCAP file.

    Attributes:
        whole: Number of bytes, from the start, that could be read.
        size: Size of the file, bytes.
        complete: True after the end of the file was reached without damage.
        damage: Damage at `whole`; empty if there is none.
        origin: Metadata of the file, after it has been read.

    Raises:
        FileFormatError: The file does not start as an MCAP file.
        OSError: The file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = path.stat().st_size
        self.whole = 0
        self.complete = False
        self.damage = ""
        self.origin: dict[str, str] = {}
        with path.open("rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise FileFormatError(
                    f"{path} is not an MCAP file, or was cut before its first record.", file=str(path)
                )

    def records(self) -> Iterator[McapRecord]:
        """Yield all records in order, those of a chunk in its place, up to the first damage."""
        with self.path.open("rb") as file:
            records = self._whole_records(file)
            while True:
                try:
                    batch = next(records, None)
                except Exception as error:  # on a damaged file the parsers may raise any error
                    self.damage = f"a record is incomplete ({str(error) or type(error).__name__})"
                    return
                if batch is None:
                    self.complete = True
                    return
                yield from batch

    def bus_messages(self) -> Iterator[tuple[int, RawSample]]:
        """Yield time of arrival, ns since 1970, and message of the bus; other topics are skipped.

        Raises:
            FileFormatError: A message is not of PCMRS.
        """
        keys: dict[int, str] = {}
        for record in self.records():
            if isinstance(record, Channel) and record.topic.startswith(raw.PREFIX):
                keys[record.id] = record.topic.removeprefix(raw.PREFIX)
            elif isinstance(record, Message) and record.channel_id in keys:
                monotonic, payload = raw.decode(record.data)
                yield record.log_time, RawSample(keys[record.channel_id], payload, monotonic)

    def format(self) -> int:
        """Return the version of the recording, after its metadata has been read; 1 if it names none."""
        found = self.origin.get(FORMAT_KEY, "")
        return int(found) if found.isascii() and found.isdigit() else 1

    def _whole_records(self, file: BinaryIO) -> Iterator[list[McapRecord]]:
        """Yield each record, or the records of a chunk, which counts only as a whole."""
        declared = _Declared()
        # No record is longer than the file: a damaged length must not take all memory.
        for record in StreamReader(file, emit_chunks=True, record_size_limit=self.size).records:
            batch = _parts(record) if isinstance(record, Chunk) else [record]
            for each in batch:
                declared.check(each)
            self.whole = self.size if isinstance(record, Footer) else file.tell()
            if isinstance(record, Metadata) and record.name == METADATA:
                self.origin = record.metadata
            yield batch


def recording_format(path: Path) -> int | None:
    """Return the version of a recording, from its beginning; None if it has no metadata of PCMRS.

    Raises:
        FileFormatError: The file does not start as an MCAP file.
        OSError: The file cannot be read.
    """
    reader = RecordingReader(path)
    for _ in reader.records():
        if reader.origin:
            return reader.format()
    return None


def check_format(path: Path) -> None:
    """Refuse a recording of a later version.

    Raises:
        FileFormatError: It is one, or does not start as an MCAP file.
        OSError: The file cannot be read.
    """
    found = recording_format(path)
    if found is not None and found > FORMAT:
        text = f"{path} has format {found}, and this version of PCMRS reads 1 to {FORMAT}: use a later version."
        raise FileFormatError(text, file=str(path), format=found, limit=FORMAT)


def _parts(chunk: Chunk) -> list[McapRecord]:
    """Return the records of a chunk. Raises `ValueError` before it is decompressed to more than `LARGEST_CHUNK`."""
    size = len(chunk.data)
    if chunk.compression == "zstd":
        # The decompressor uses the size in the frame, and that of the chunk's record only if the frame has none.
        size = max(chunk.uncompressed_size, zstandard.frame_content_size(chunk.data))
    elif chunk.compression:
        raise ValueError(f"a chunk is compressed by {chunk.compression!r}: only zstd is known")
    if size > LARGEST_CHUNK:
        raise ValueError(f"a chunk has {size} bytes when decompressed, more than {LARGEST_CHUNK}")
    return breakup_chunk(chunk, validate_crc=True)


class _Declared:
    """Channels and schemas declared so far: a message needs its channel, and a channel its schema."""

    def __init__(self) -> None:
        self._schemas = {0}  # 0 stands for no schema
        self._channels: set[int] = set()

    def check(self, record: McapRecord) -> None:
        """Raise `ValueError` if the record needs a channel or schema that was not declared before it."""
        if isinstance(record, Message):
            if record.channel_id not in self._channels:
                raise ValueError(f"channel {record.channel_id} was not declared")
        elif isinstance(record, Schema):
            self._schemas.add(record.id)
        elif isinstance(record, Channel):
            if record.schema_id not in self._schemas:
                raise ValueError(f"schema {record.schema_id} was not declared")
            self._channels.add(record.id)
