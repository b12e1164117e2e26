"""A whole file from what is left of a damaged one."""

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
    """What a repair came to.

    Attributes:
        complete: The file was whole; nothing is lost.
        messages: That were saved, of all topics.
        kept_bytes: Of the damaged file, up to the last whole record or chunk.
        lost_bytes: What comes after.
        damage: What was wrong there; empty where nothing was.
        until: Time of the last message that was saved, s since 1970; None where there is none.
    """

    complete: bool
    messages: int
    kept_bytes: int
    lost_bytes: int
    damage: str = ""
    until: float | None = None


def repair(source: Path, target: Path) -> RepairReport:
    """Write what can be read of an MCAP file, up to its last whole chunk, as a file of its own.

    Args:
        source: Stays as it is.
        target: Must not exist.

    Raises:
        FileFormatError: The source does not begin as an MCAP file.
        ConfigurationError: The target is there already.
        OSError: One of them cannot be read or written.
    """
    reading = RecordingReader(source)
    if target.exists():
        raise ConfigurationError(f"{target} is there already: give another name.", file=str(target))
    with target.open("xb") as file:
        copy = _Copy(Writer(file, chunk_size=CHUNK))
        for record in reading.records():
            copy.take(record)
        copy.finish()
    return RepairReport(
        complete=reading.complete,
        messages=copy.messages,
        kept_bytes=reading.whole,
        lost_bytes=reading.size - reading.whole,
        damage=reading.damage,
        until=copy.latest_ns / 1e9 if copy.messages else None,
    )


class _Copy:
    """Takes records of one file into another, where schemas and channels have numbers of their own."""

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
