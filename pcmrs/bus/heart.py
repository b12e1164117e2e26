"""The process that sends the daemon's heartbeats: so small that nothing in it can keep a beat from going out.

The daemon's loop gives its signs of life on standard input. Each is sent as a beat, and none is invented: a daemon that
hangs is silent. The end of the input is the end of the daemon. Beside that it watches the threads of the daemon and of
the nodes that have the real-time policy, and takes it from one that runs away.

    python -m pcmrs.bus.heart < settings and signs of life
"""

from __future__ import annotations

import os
import select
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import msgspec
import zenoh
from zenoh import ext

from pcmrs.bus.codec import pack
from pcmrs.bus.declare import declare_publisher
from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.qos import class_of
from pcmrs.bus.seal import Seal
from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.clock import SystemClock
from pcmrs.errors import PcmrsError
from pcmrs.messages import Beat, DeviceEvent
from pcmrs.threads import Priority, RealTime, Runaway, Runaways

SIGN = struct.Struct("<Qd")
"""A sign of life: its number, and when the loop gave it, s of the machine's monotonic clock."""


LOOK = 0.1
"""Between two looks at the threads, s."""
EVENTS = "daemon/event"


class HeartSettings(msgspec.Struct, frozen=True, kw_only=True):
    """First line of standard input, in JSON.

    Attributes:
        bus: Where the beats go.
        key: Under which relative key.
        session: Of the daemon.
        device_key: With which daemon and nodes seal what they send.
    """

    bus: BusSettings
    key: str
    session: str
    device_key: bytes


Sign = tuple[int, float]


class Heart:
    """Sends beats, and watches between them.

    Args:
        session: Of Zenoh.
        settings: What is sent, and where.
        daemon: Id of the daemon's process.
    """

    def __init__(self, session: zenoh.Session, settings: HeartSettings, daemon: int) -> None:
        self._session, self._settings = session, settings
        self._prefix = cell_prefix(settings.bus.site, settings.bus.cell)
        self._seal = Seal(settings.device_key)
        self._beats = self._publisher(settings.key)
        self._events = self._publisher(EVENTS)
        self._clock = SystemClock()
        self._realtime = RealTime(Priority.HEART)
        self._runaways = Runaways(lambda: family(daemon))
        self._looked = -LOOK

    def run(self, signs: Iterator[Sign | None]) -> None:
        """Sends a beat for each sign of life until there are no more."""
        for sign in signs:
            if sign is not None:
                number, alive = sign
                sent = self._clock.monotonic()
                self._put(self._beats, Beat(number=number, session=self._settings.session, alive=alive, sent=sent))
            self._watch()

    def _watch(self) -> None:
        now = self._clock.monotonic()
        if now - self._looked < LOOK:
            return
        self._looked = now
        with suppress(PermissionError):
            self._realtime.give()
        for each in self._runaways.look(now):
            self._put(self._events, _demoted(each))

    def _put(self, publisher: zenoh.Publisher | ext.AdvancedPublisher, message: Beat | DeviceEvent) -> None:
        payload = pack(message)
        publisher.put(payload, attachment=self._seal.put("put", str(publisher.key_expr), payload))

    def _publisher(self, key: str) -> zenoh.Publisher | ext.AdvancedPublisher:
        return declare_publisher(self._session, f"{self._prefix}/{key}", class_of(key))


def family(daemon: int) -> list[int]:
    """Ids of a daemon's process and of its children; not of this one, which would otherwise be watched by itself."""
    found = [daemon]
    for task in Path(f"/proc/{daemon}/task").glob("*/children"):
        with suppress(OSError):  # the thread has ended
            found += map(int, task.read_text().split())
    return [process for process in found if process != os.getpid()]


def _demoted(runaway: Runaway) -> DeviceEvent:
    text = (
        f"Thread {runaway.name} ({runaway.thread}) of process {runaway.process} ran for {runaway.ran:.1f} s without a "
        "rest and has lost the real-time policy until it rests again. The cell works on, but a busy machine may now "
        "delay heartbeats. The log says what the loop was doing."
    )
    return DeviceEvent(device="daemon", code="thread_demoted", text=text, fields=runaway._asdict())


def signs_of(descriptor: int) -> Iterator[Sign | None]:
    """Signs of life from a file; of those that have come meanwhile, the newest, and None when none comes for `LOOK`."""
    received = b""
    while True:
        if not select.select([descriptor], [], [], LOOK)[0]:
            yield None
            continue
        read = os.read(descriptor, 256 * SIGN.size)
        if not read:
            return
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
        session = open_session(settings.bus)
    except PcmrsError as error:
        sys.exit(f"The daemon's heart: {error.text}")
    try:
        Heart(session, settings, os.getppid()).run(signs_of(descriptor))
    finally:
        session.close()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main()
