"""An MCAP file that is being written, and the topics that all files of a recording share."""

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
from pcmrs.recording._foxglove_messages import FoxgloveView, json_bytes, json_schema


class CountingFile:
    """A new append-only file that counts its bytes.

    It stores the first disk error and discards all later data: otherwise the MCAP writer would report the error for
    each message, and could not be closed.

    Args:
        path: Path of the file. It must not exist.

    Attributes:
        size: Number of bytes written.
        error: First error; None if there was none.

    Raises:
        OSError: The file exists, or cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.size = 0
        self.error: OSError | None = None
        self._file = path.open("xb", buffering=1 << 16)

    def write(self, data: bytes | bytearray) -> int:
        """Append the data; return its length."""
        self._attempt(lambda: self._file.write(data))
        self.size += len(data)
        return len(data)

    def seek(self, offset: int, whence: int = SEEK_SET) -> int:
        """Return the end of the file, the only position allowed.

        Args:
            offset: Offset, bytes.
            whence: Reference of the offset, as for `io.IOBase.seek`.

        Raises:
            OSError: The position is not the end.
        """
        if (offset, whence) not in ((0, SEEK_CUR), (self.size, SEEK_SET)):
            raise OSError(f"{self._file.name} can only be appended to.")
        return self.size

    def flush(self) -> None:
        """Pass all data to the operating system, so that it survives the end of this process."""
        self._attempt(self._file.flush)

    def close(self) -> None:
        """Write all data to the disk and close the file."""
        self._attempt(self._file.flush)
        self._attempt(lambda: os.fsync(self._file.fileno()))
        try:
            self._file.close()
        except OSError as error:  # from data that could not be flushed before
            self.error = self.error or error

    def _attempt(self, act: Callable[[], object]) -> None:
        if self.error is None:
            try:
                act()
            except OSError as error:
                self.error = error


CHUNK: Final = 16_384
"""Size of a chunk, bytes: a killed writer loses at most one, besides the messages since the last flush."""

METADATA: Final = "pcmrs"
FORMAT: Final = 1
"""Version of the messages and metadata of a recording; the container has its own (MCAP 0)."""
FORMAT_KEY: Final = "format"
"""Key of `FORMAT` in the metadata. Recordings without it are of version 1."""

_CHANNELS: dict[type, Any] = {
    FrameTransforms: FrameTransformsChannel,
    JointStates: JointStatesChannel,
    Log: LogChannel,
    PoseInFrame: PoseInFrameChannel,
}


class Topics:
    """Topics of a recording, written into the file that is open in their context, and declared at first use."""

    def __init__(self) -> None:
        self.context = Context()
        self._raw = Schema(name=raw.NAME, encoding="protobuf", data=raw.schema())
        self._channels: dict[str, Any] = {}

    def write_raw(self, key: str, monotonic: float, payload: bytes, at_ns: int) -> None:
        """Write a message of the bus unchanged.

        Args:
            key: Key, relative to the cell.
            monotonic: Time of arrival, s of the machine's monotonic clock.
            payload: Payload on the bus.
            at_ns: Time of arrival, ns since 1970.
        """
        topic = raw.PREFIX + key
        if topic not in self._channels:
            channel = Channel(topic, schema=self._raw, message_encoding="protobuf", context=self.context)
            self._channels[topic] = channel
        self._channels[topic].log(raw.encode(monotonic, payload), log_time=at_ns)

    def write(self, topic: str, view: FoxgloveView, at_ns: int) -> None:
        """Write a view.

        Args:
            topic: Topic; all its views are of one type.
            view: Message to be written.
            at_ns: Time of the view, ns since 1970.
        """
        if topic not in self._channels:
            self._channels[topic] = self._opened(topic, view)
        self._channels[topic].log(json_bytes(view) if isinstance(view, Message) else view, log_time=at_ns)

    def _opened(self, topic: str, view: FoxgloveView) -> Any:
        if isinstance(view, Message):
            return Channel(topic, schema=json_schema(type(view)), context=self.context)
        return _CHANNELS[type(view)](topic, context=self.context)


class RecordingFile:
    """An MCAP file that receives what is written to the topics of its context.

    Args:
        path: Path of the file. It must not exist.
        topics: Topics; only one file at a time may be open in their context.
        metadata: Metadata of the file, such as cell, session and versions.

    Raises:
        OSError: The file exists, or cannot be created.
    """

    def __init__(self, path: Path, topics: Topics, metadata: dict[str, str]) -> None:
        self.path = path
        self._sink = CountingFile(path)
        # Without seeking, a chunk reaches the file as a whole; without threads, the writer uses one processor at most.
        options = MCAPWriteOptions(chunk_size=CHUNK, disable_seeking=True, compression_threads=0)
        self._writer = foxglove.open_mcap(self._sink, context=topics.context, writer_options=options)
        self._writer.write_metadata(METADATA, {FORMAT_KEY: str(FORMAT)} | metadata)

    @property
    def size(self) -> int:
        """Number of bytes written, without the present chunk."""
        return self._sink.size

    @property
    def error(self) -> OSError | None:
        """Error after which nothing more is written; None if there was none."""
        return self._sink.error

    def flush(self) -> None:
        """End the chunk, so that all data until now survives the end of this process."""
        self._writer.flush()

    def close(self) -> None:
        """Write the summary and close the file; a failure is in `error`."""
        self._writer.close()
        self._sink.close()
