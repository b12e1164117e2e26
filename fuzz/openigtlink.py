"""OpenIGTLink: any bytes, and any body with a correct CRC, up to the resulting frames and plans.

python -m fuzz.openigtlink -max_total_time=60
"""

from __future__ import annotations

import asyncio
import struct
from contextlib import suppress
from typing import Any

from fuzz.running import instrumented, pieces, run

with instrumented("pcmrs.devices.plus", "pcmrs.gateway.openigtlink", "pyigtl"):
    from pyigtl.messages import CRC64

    from pcmrs.devices.plus.frames import FrameAssembler, MessageReader
    from pcmrs.devices.plus.messages import readings
    from pcmrs.errors import PayloadError, RefusalError
    from pcmrs.gateway.openigtlink import plans

KINDS = ("TRANSFORM", "POINT", "STRING", "STATUS", "TDATA")
NAMES = {"CoilToTracker": "coil", "a": "body_ref"}
HEADER = struct.Struct(">H12s20sQQQ")


def with_header(data: bytes) -> bytes:
    """Return a message with a valid header, of a kind and version that the data select."""
    choice, stamp, body = data[:1], data[1:9].ljust(8, b"\0"), data[9:]
    kind, version = KINDS[choice[0] % 5 if choice else 0].encode(), 1 + (choice > b"\x7f")
    return HEADER.pack(version, kind, b"CoilToTracker", *struct.unpack(">Q", stamp), len(body), CRC64(body)) + body


async def one(data: bytes) -> None:
    """Read the messages of a stream."""
    raw, rest = data[:1] > b"\xc0", data[1:]
    stream = asyncio.StreamReader()
    for piece in pieces(rest) if raw else [with_header(rest)]:
        stream.feed_data(piece)
    stream.feed_eof()
    reader, frames = MessageReader(stream, KINDS), FrameAssembler(NAMES, 0.02)
    with suppress(asyncio.IncompleteReadError, ConnectionAbortedError):
        while True:
            with suppress(PayloadError):
                message = await reader.read()
                if message is not None:
                    use(message, frames)


def use(message: Any, frames: FrameAssembler) -> None:
    """Convert a message to frames or plans.

    Args:
        message: Message of pyigtl.
        frames: Assembler of frames.
    """
    if message.message_type in ("TRANSFORM", "TDATA"):
        frames.take(readings(message), message.timestamp, 1.0, 1.7e9, whole=message.message_type == "TDATA")
    with suppress(RefusalError):
        if message.message_type == "TRANSFORM":
            plans.target(message.matrix.tolist())
        elif message.message_type == "POINT":
            plans.landmarks(message.positions, message.names)
    if message.message_type == "STRING":
        message.string.strip().lower()


if __name__ == "__main__":
    run(one)
