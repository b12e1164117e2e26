"""The heart: the process that sends the daemon's heartbeats, so small that nothing in it can delay one.

The daemon's loop writes signs of life to the standard input of this process. Each one is sent as a heartbeat, and none
is made up: a daemon that hangs is silent. The input ends with the daemon. The heart also watches the real-time threads
of the daemon and of the device nodes, and takes the real-time policy away from one that runs away.

    python -m pcmrs.bus.heart < settings and signs of life
"""

from __future__ import annotations

import os
import select
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress

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
from pcmrs.threads import Priority, RealTime, Runaway, Runaways, watched_processes

SIGN = struct.Struct("<Qd")
"""A sign of life: its number, and the time at which the loop wrote it, s of the machine's monotonic clock."""

WATCH_PERIOD = 0.1
"""Time between two checks of the threads, s."""
EVENTS = "daemon/event"
"""Key of the events of the daemon's own processes."""


class HeartSettings(msgspec.Struct, frozen=True, kw_only=True):
    """First line of standard input, in JSON.

    Attributes:
        bus: Bus on which the heartbeats are sent.
        key: Relative key of the heartbeats.
        session: Session id of the daemon.
        device_key: Key with which daemon and nodes seal their messages.
        daemon: Process id of the daemon.
    """

    bus: BusSettings
    key: str
    session: str
    device_key: bytes
    daemon: int


Sign = tuple[int, float]
"""A sign of life as `SIGN` unpacks it."""


class Heart:
    """Sender of heartbeats that watches the real-time threads between them.

    Args:
        session: Zenoh session.
        settings: Contents and key of the heartbeats, and the daemon.
    """

    def __init__(self, session: zenoh.Session, settings: HeartSettings) -> None:
        self._session, self._settings = session, settings
        self._prefix = cell_prefix(settings.bus.site, settings.bus.cell)
        self._seal = Seal(settings.device_key)
        self._beats = self._publisher(settings.key)
        self._events = self._publisher(EVENTS)
        self._clock = SystemClock()
        self._realtime = RealTime(Priority.HEART)
        self._runaways = Runaways(lambda: watched_processes(settings.daemon))
        self._last_check = -WATCH_PERIOD

    def run(self, signs: Iterator[Sign | None]) -> None:
        """Send a heartbeat for each sign of life until `signs` ends."""
        for sign in signs:
            if sign is not None:
                number, alive = sign
                sent = self._clock.monotonic()
                self._put(self._beats, Beat(number=number, session=self._settings.session, alive=alive, sent=sent))
            self._watch()

    def _watch(self) -> None:
        now = self._clock.monotonic()
        if now - self._last_check < WATCH_PERIOD:
            return
        self._last_check = now
        with suppress(PermissionError):
            self._realtime.give()
        for each in self._runaways.check(now):
            self._put(self._events, runaway_event("daemon", each))

    def _put(self, publisher: zenoh.Publisher | ext.AdvancedPublisher, message: Beat | DeviceEvent) -> None:
        payload = pack(message)
        publisher.put(payload, attachment=self._seal.put("put", str(publisher.key_expr), payload))

    def _publisher(self, key: str) -> zenoh.Publisher | ext.AdvancedPublisher:
        return declare_publisher(self._session, f"{self._prefix}/{key}", class_of(key))


def runaway_event(device: str, runaway: Runaway) -> DeviceEvent:
    """Return the event of a real-time thread that has run away.

    Args:
        device: Name that the event is reported under: ``daemon``, or a device of the node that runs the thread.
        runaway: The thread.
    """
    text = (
        f"Thread {runaway.name} ({runaway.thread}) of process {runaway.process} ran for {runaway.ran:.1f} s without a "
        "pause"
    )
    if runaway.refused:
        text += (
            f", and its real-time policy could not be taken away: {runaway.refused}. Other programs may not get a "
            "processor. Stop other programs, and restart PCMRS. The log shows what the loop was doing."
        )
    else:
        text += (
            " and has lost the real-time policy until it pauses again. The cell still works, but a busy machine may "
            "now delay heartbeats. The log shows what the loop was doing."
        )
    code = "thread_not_demoted" if runaway.refused else "thread_demoted"
    return DeviceEvent(device=device, code=code, text=text, fields=runaway._asdict())


def read_signs(descriptor: int) -> Iterator[Sign | None]:
    """Yield the newest sign of life that can be read from a file, and None if none arrives for `WATCH_PERIOD`."""
    received = b""
    while True:
        if not select.select([descriptor], [], [], WATCH_PERIOD)[0]:
            yield None
            continue
        read = os.read(descriptor, 256 * SIGN.size)
        if not read:
            return
        received += read
        if whole := len(received) // SIGN.size * SIGN.size:
            yield SIGN.unpack_from(received, whole - SIGN.size)
            received = received[whole:]


def read_line(descriptor: int) -> bytes:
    """Read up to the first line break and not beyond it."""
    line = b""
    while (read := os.read(descriptor, 1)) not in (b"", b"\n"):
        line += read
    return line


def main() -> None:
    """Run until standard input ends; exit with status 1 if the router does not answer."""
    descriptor = sys.stdin.fileno()
    settings = msgspec.json.decode(read_line(descriptor), type=HeartSettings)
    try:
        session = open_session(settings.bus)
    except PcmrsError as error:
        sys.exit(f"The daemon's heart: {error.text}")
    try:
        Heart(session, settings).run(read_signs(descriptor))
    finally:
        session.close()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main()
