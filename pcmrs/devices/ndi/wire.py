"""Messages between the driver and its reader process: MessagePack behind a length of four bytes."""

from __future__ import annotations

from typing import BinaryIO

import msgspec

from pcmrs.devices.framing import LENGTH_SIZE, MessageSplitter, framed, length_of
from pcmrs.errors import PayloadError

LARGEST = 1 << 20
"""Limit of the length of one message, bytes."""


class ReaderJob(msgspec.Struct, frozen=True):
    """Job of the reader.

    Attributes:
        device: ``host:port``, or the path of a serial port.
        baud: Baud rate of the serial port.
        tools: Definition of the tool of each body.
    """

    device: str
    baud: int
    tools: dict[str, bytes]


class ToolFrame(msgspec.Struct, frozen=True, array_like=True):
    """One tool in one frame.

    Attributes:
        body: Body to which the tool is fixed.
        frame_number: Frame number of the tracker.
        status: Status bits of the tool's port.
        numbers: Quaternion w x y z, translation and fit error in mm, (8,); None while the tool is not visible.
    """

    body: str
    frame_number: int
    status: int
    numbers: tuple[float, float, float, float, float, float, float, float] | None


class NdiFrame(msgspec.Struct, frozen=True, tag="frame"):
    """All tools in the answer to one poll.

    Attributes:
        arrived: Arrival time of the answer, s of the machine's monotonic clock.
        system_status: Status bits of the system.
        tools: Tools in the order of the job.
    """

    arrived: float
    system_status: int
    tools: list[ToolFrame]


class TrackerReady(msgspec.Struct, frozen=True, tag="ready"):
    """The tracker tracks.

    Attributes:
        version: Version text of the tracker.
        binary: True if it answers in single precision, False if in text.
    """

    version: str
    binary: bool


class Failed(msgspec.Struct, frozen=True, tag="failed"):
    """The reader ends for the reason in `text`."""

    text: str


Report = NdiFrame | TrackerReady | Failed

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Report)


def pack(message: ReaderJob | Report) -> bytes:
    """Return the encoded message with its length in front."""
    return framed(_encoder.encode(message))


def read_job(stream: BinaryIO) -> ReaderJob:
    """Read the job at the beginning of `stream`, and nothing beyond it."""
    return msgspec.msgpack.decode(stream.read(length_of(stream.read(LENGTH_SIZE))), type=ReaderJob)


class Unpacker:
    """Splitter of a stream of bytes into reports, however the stream is cut into pieces."""

    def __init__(self) -> None:
        self._splitter = MessageSplitter(LARGEST)

    def feed(self, data: bytes) -> list[Report]:
        """Return the reports that `data` completes.

        Raises:
            PayloadError: A message is not a report, or is longer than the limit.
        """
        return [_report(body) for body in self._splitter.feed(data)]


def _report(body: bytes) -> Report:
    try:
        report: Report = _decoder.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise PayloadError(f"Not a report of a reader: {error}.") from None
    return report
