"""What the driver and its reader process say to each other: MessagePack behind a length of four bytes."""

from __future__ import annotations

from typing import BinaryIO

import msgspec

from pcmrs.devices.framing import LENGTH_SIZE, Cutter, framed, length_of
from pcmrs.errors import PayloadError

LARGEST = 1 << 20
"""Bytes of one message; a longer one is no message of ours."""


class Job(msgspec.Struct, frozen=True):
    """What the reader is to do.

    Attributes:
        device: ``host:port``, or the path of a serial port.
        baud: Of the serial port.
        tools: Body to the definition of its tool.
    """

    device: str
    baud: int
    tools: dict[str, bytes]


class ToolFrame(msgspec.Struct, frozen=True, array_like=True):
    """One tool in one frame.

    Attributes:
        body: What the tool is fixed to.
        frame_number: The tracker's own.
        status: Bits of the port's status.
        numbers: Quaternion w x y z, translation and fit error in mm, (8,); None while it is missing.
    """

    body: str
    frame_number: int
    status: int
    numbers: tuple[float, float, float, float, float, float, float, float] | None


class Frame(msgspec.Struct, frozen=True, tag="frame"):
    """All tools as the tracker had them at one question.

    Attributes:
        arrived: When the answer came, s of the machine's monotonic clock.
        system_status: Bits of the system's status.
        tools: Of the job, in its order.
    """

    arrived: float
    system_status: int
    tools: list[ToolFrame]


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    """The tracker tracks.

    Attributes:
        version: What it says of itself.
        binary: It answers in single precision, not in text.
    """

    version: str
    binary: bool


class Failed(msgspec.Struct, frozen=True, tag="failed"):
    """The reader ends, and why."""

    text: str


Report = Frame | Ready | Failed

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Report)


def pack(message: Job | Report) -> bytes:
    """The message with its length."""
    return framed(_encoder.encode(message))


def read_job(stream: BinaryIO) -> Job:
    """The job at the beginning of `stream`, and nothing behind it."""
    return msgspec.msgpack.decode(stream.read(length_of(stream.read(LENGTH_SIZE))), type=Job)


class Unpacker:
    """Cuts a stream of bytes into reports; survives any split of them."""

    def __init__(self) -> None:
        self._cutter = Cutter(LARGEST)

    def feed(self, data: bytes) -> list[Report]:
        """The reports that `data` completes.

        Raises:
            PayloadError: This is no report, or a longer one than there can be.
        """
        return [_report(body) for body in self._cutter.feed(data)]


def _report(body: bytes) -> Report:
    try:
        report: Report = _decoder.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise PayloadError(f"No report of a reader: {error}.") from None
    return report
