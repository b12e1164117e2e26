"""One MCAP file in writing, and the topics that all files of a recording share.

One file as the writer of MCAP sees it: it counts, and a full disk never reaches the writer.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from io import SEEK_CUR, SEEK_SET
from pathlib import Path
from typing import Any, Final

import foxglove
from foxglove import Channel, Context, Schema
from foxglove.channels import FrameTransformsChannel, JointStatesChannel, LogChannel, PoseInFrameChannel
from foxglove.mcap import MCAPWriteOptions
from foxglove.messages import FrameTransforms, JointStates, Log, PoseInFrame

from pcmrs.messages import Message
from pcmrs.recording import raw
from pcmrs.recording.shapes import View, json_bytes, json_schema


class CountingFile:
    """A new file that is only ever appended to.

    An error of the disk is kept, and what comes afterwards is thrown away: the writer would report the same error for
    each message, and could not even be closed.

    Args:
        path: Of the file; must not exist.

    Attributes:
        size: Bytes written.
        error: What went wrong first; None so far.

    Raises:
        OSError: It exists, or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.size = 0
        self.error: OSError | None = None
        self._file = path.open("xb", buffering=1 << 16)

    def write(self, data: bytes | bytearray) -> int:
        """Append all of it."""
        self._attempt(lambda: self._file.write(data))
        self.size += len(data)
        return len(data)

    def seek(self, offset: int, whence: int = SEEK_SET) -> int:
        """The end, where the writer is and stays. Raises `OSError` for any other place."""
        if (offset, whence) not in ((0, SEEK_CUR), (self.size, SEEK_SET)):
            raise OSError(f"{self._file.name} can only be appended to.")
        return self.size

    def flush(self) -> None:
        """Hand everything to the operating system, so that it survives the end of this process."""
        self._attempt(self._file.flush)

    def close(self) -> None:
        """End the file; the disk has it then."""
        self._attempt(self._file.flush)
        self._attempt(lambda: os.fsync(self._file.fileno()))
        try:
            self._file.close()
        except OSError as error:  # what could not be flushed before
            self.error = self.error or error

    def _attempt(self, act: Callable[[], object]) -> None:
        if self.error is None:
            try:
                act()
            except OSError as error:
                self.error = error


CHUNK: Final = 16_384
"""Bytes that are compressed together; what a killed writer loses at most, besides what came since the last flush."""

METADATA: Final = "pcmrs"

_CHANNELS: dict[type, Any] = {
    FrameTransforms: FrameTransformsChannel,
    JointStates: JointStatesChannel,
    Log: LogChannel,
    PoseInFrame: PoseInFrameChannel,
}


class Topics:
    """Writes into whichever file is open in its context; topics are declared when they are first used."""

    def __init__(self) -> None:
        self.context = Context()
        self._raw = Schema(name=raw.NAME, encoding="protobuf", data=raw.schema())
        self._channels: dict[str, Any] = {}

    def write_raw(self, key: str, monotonic: float, payload: bytes, at_ns: int) -> None:
        """Record a message of the bus as it was.

        Args:
            key: Relative to the cell.
            monotonic: When it came, s of the machine's monotonic clock.
            payload: As it was on the bus.
            at_ns: When it came, ns since 1970.
        """
        topic = raw.PREFIX + key
        if topic not in self._channels:
            channel = Channel(topic, schema=self._raw, message_encoding="protobuf", context=self.context)
            self._channels[topic] = channel
        self._channels[topic].log(raw.encode(monotonic, payload), log_time=at_ns)

    def write(self, topic: str, view: View, at_ns: int) -> None:
        """Record something to look at, ns since 1970; a topic always has views of one type."""
        if topic not in self._channels:
            self._channels[topic] = self._opened(topic, view)
        self._channels[topic].log(json_bytes(view) if isinstance(view, Message) else view, log_time=at_ns)

    def _opened(self, topic: str, view: View) -> Any:
        if isinstance(view, Message):
            return Channel(topic, schema=json_schema(type(view)), context=self.context)
        return _CHANNELS[type(view)](topic, context=self.context)


class RecordingFile:
    """An MCAP file that takes what is written to the topics of its context.

    Args:
        path: Of the file; must not exist.
        topics: Only one file at a time may be open in their context.
        metadata: What the file says of itself.

    Raises:
        OSError: It exists, or cannot be made.
    """

    def __init__(self, path: Path, topics: Topics, metadata: dict[str, str]) -> None:
        self.path = path
        self._sink = CountingFile(path)
        # Without seeking a chunk reaches the file as a whole; with one thread the writer takes one processor at most.
        options = MCAPWriteOptions(chunk_size=CHUNK, disable_seeking=True, compression_threads=0)
        self._writer = foxglove.open_mcap(self._sink, context=topics.context, writer_options=options)
        self._writer.write_metadata(METADATA, metadata)

    @property
    def size(self) -> int:
        """Bytes written; what is in the present chunk comes on top."""
        return self._sink.size

    @property
    def error(self) -> OSError | None:
        """Why nothing more can be written; None while all is well."""
        return self._sink.error

    def flush(self) -> None:
        """End the chunk: what was written until now survives the end of this process."""
        self._writer.flush()

    def close(self) -> None:
        """Write the summary and ends the file; whether that worked says `error`."""
        self._writer.close()
        self._sink.close()
