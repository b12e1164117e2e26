"""Repair of a damaged recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import Writer

from pcmrs.errors import ConfigurationError
from pcmrs.messages import Message as Struct
from pcmrs.recording.file import CHUNK
from pcmrs.recording.reader import RecordingReader


class RepairReport(Struct, frozen=True, kw_only=True, omit_defaults=False):
    """Result of a repair.

    Attributes:
        complete: True if the file was whole and nothing is lost.
        messages: Number of saved messages, of all topics.
        kept_bytes: Number of bytes of the damaged file up to the last whole record or chunk.
        lost_bytes: Number of bytes after that.
        damage: Damage there; empty if there is none.
        until: Time of the last saved message, s since 1970; None if there is none.
    """

    complete: bool
    messages: int
    kept_bytes: int
    lost_bytes: int
    damage: str = ""
    until: float | None = None


def repair(source: Path, target: Path) -> RepairReport:
    """Copy the readable part of an MCAP file, up to its last whole chunk, into a new file.

    Args:
        source: Damaged file; it is not changed.
        target: New file. It must not exist.

    Raises:
        FileFormatError: The source does not start as an MCAP file.
        ConfigurationError: The target exists.
        OSError: One of them cannot be read or written.
    """
    reader = RecordingReader(source)
    if target.exists():
        raise ConfigurationError(f"{target} already exists: give another name.", file=str(target))
    with target.open("xb") as file:
        copy = _Copy(Writer(file, chunk_size=CHUNK))
        for record in reader.records():
            copy.take(record)
        copy.finish()
    return RepairReport(
        complete=reader.complete,
        messages=copy.messages,
        kept_bytes=reader.whole,
        lost_bytes=reader.size - reader.whole,
        damage=reader.damage,
        until=copy.latest_ns / 1e9 if copy.messages else None,
    )


class _Copy:
    """Copy of records into another file, with new numbers of schemas and channels."""

    def __init__(self, writer: Any) -> None:
        self.messages = 0
        self.latest_ns = 0
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        writer.start()

    def take(self, record: McapRecord) -> None:
        if isinstance(record, Message):
            self._message(record)
        elif isinstance(record, Schema):
            if record.id not in self._schemas:
                number = self._writer.register_schema(record.name, record.encoding, record.data)
                self._schemas[record.id] = number
        elif isinstance(record, Channel):
            if record.id not in self._channels:
                number = self._writer.register_channel(
                    record.topic, record.message_encoding, self._schemas[record.schema_id], record.metadata
                )
                self._channels[record.id] = number
        elif isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )

    def finish(self) -> None:
        self._writer.finish()

    def _message(self, record: Message) -> None:
        self._writer.add_message(
            self._channels[record.channel_id], record.log_time, record.data, record.publish_time, record.sequence
        )
        self.messages += 1
        self.latest_ns = max(self.latest_ns, record.log_time)
