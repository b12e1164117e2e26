"""The process that sends the daemon's heartbeats: so small that nothing in it can keep a beat from going out.

The daemon's loop gives its signs of life on standard input. Each is sent as a beat, and none is invented: a daemon that
hangs is silent. The end of the input is the end of the daemon.

    python -m pcmrs.bus.heart < settings and signs of life
"""

from __future__ import annotations

import os
import struct
import sys
from collections.abc import Iterator

import msgspec

from pcmrs.bus.codec import pack
from pcmrs.bus.declare import declare_publisher
from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.qos import class_of
from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.clock import SystemClock
from pcmrs.errors import PcmrsError
from pcmrs.messages import Beat

SIGN = struct.Struct("<Qd")
"""A sign of life: its number, and when the loop gave it, s of the machine's monotonic clock."""


class HeartSettings(msgspec.Struct, frozen=True, kw_only=True):
    """First line of standard input, in JSON.

    Attributes:
        bus: Where the beats go.
        key: Under which relative key.
        session: Of the daemon.
    """

    bus: BusSettings
    key: str
    session: str


def beat(settings: HeartSettings, signs: Iterator[tuple[int, float]]) -> None:
    """Sends a beat for each sign of life until there are no more.

    Raises:
        BusError: The daemon's router does not answer.
    """
    session, clock = open_session(settings.bus), SystemClock()
    try:
        prefix = cell_prefix(settings.bus.site, settings.bus.cell)
        publisher = declare_publisher(session, f"{prefix}/{settings.key}", class_of(settings.key))
        for number, alive in signs:
            publisher.put(pack(Beat(number=number, session=settings.session, alive=alive, sent=clock.monotonic())))
    finally:
        session.close()  # type: ignore[no-untyped-call]


def signs_of(descriptor: int) -> Iterator[tuple[int, float]]:
    """Signs of life from a file; of those that have come meanwhile, the newest."""
    received = b""
    while read := os.read(descriptor, 256 * SIGN.size):
        received += read
        if whole := len(received) // SIGN.size * SIGN.size:
            yield SIGN.unpack_from(received, whole - SIGN.size)
            received = received[whole:]


def first_line(descriptor: int) -> bytes:
    """Up to the first line break; nothing behind it is read."""
    line = b""
    while (read := os.read(descriptor, 1)) not in (b"", b"\n"):
        line += read
    return line


def main() -> None:
    """Runs until standard input ends. Exit status 1: the router does not answer."""
    descriptor = sys.stdin.fileno()
    settings = msgspec.json.decode(first_line(descriptor), type=HeartSettings)
    try:
        beat(settings, signs_of(descriptor))
    except PcmrsError as error:
        sys.exit(f"The daemon's heart: {error.text}")


if __name__ == "__main__":
    main()
