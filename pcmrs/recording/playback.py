"""A recording on the bus again, under a prefix that is no cell's."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from pcmrs.bus import BusSettings
from pcmrs.bus.declare import declare_publisher
from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.qos import class_of
from pcmrs.bus.settings import open_session
from pcmrs.clock import Clock
from pcmrs.errors import ConfigurationError, FileFormatError
from pcmrs.messages import Message
from pcmrs.recording.reader import RecordingReader
from pcmrs.recording.subscriber import RawSample
from pcmrs.recording.topics import TopicFilter

if TYPE_CHECKING:
    import zenoh

SITE: Final = "replay"
"""Recordings are played to cells of this site only, where no robot listens."""

_ASKING = 1.0
_SECOND = 1_000_000_000

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Excerpt:
    """What of a recording is played, and how fast.

    Attributes:
        begin: s since the first message.
        end: The same; None for all.
        topics: Key expressions; none for all.
        rate: Seconds of the recording per second of the machine.
    """

    begin: float = 0.0
    end: float | None = None
    topics: tuple[str, ...] = ()
    rate: float = 1.0


class PlaybackReport(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What was played.

    Attributes:
        prefix: Where it was heard.
        messages: How many.
        duration: Of the recording from its first message to the last that was played, s.
        lost_bytes: Of damaged files, that could not be read.
        damage: What was wrong with them, one line for each.
    """

    prefix: str
    messages: int
    duration: float
    lost_bytes: int
    damage: list[str] = msgspec.field(default_factory=list)


class PlaybackPublisher:
    """Publishes on the bus what files say. Use `PlaybackPublisher.open`.

    Attributes:
        prefix: Under which the keys lie.
    """

    def __init__(self, session: zenoh.Session, prefix: str, clock: Clock) -> None:
        self.prefix = prefix
        self._session = session
        self._clock = clock
        self._publishers: dict[str, Any] = {}

    @classmethod
    async def open(cls, endpoint: str, name: str, clock: Clock) -> PlaybackPublisher:
        """Join the bus, if nobody there is a daemon by that name.

        Args:
            endpoint: Of a running daemon's bus, or of another router.
            name: Of the cell that is played: its prefix is ``pcmrs/replay/<name>``.
            clock: Of the machine.

        Raises:
            BusError: Nobody answers at the endpoint.
            PayloadError: The name cannot be a part of a key.
            ConfigurationError: A daemon runs under that prefix.
        """
        prefix = cell_prefix(SITE, name)
        loop = asyncio.get_running_loop()
        session = await loop.run_in_executor(None, open_session, BusSettings(endpoint=endpoint))
        player = cls(session, prefix, clock)
        if await loop.run_in_executor(None, player._is_live):
            await player.close()
            raise ConfigurationError(f"A daemon runs under {prefix}: choose another name by --as.", prefix=prefix)
        return player

    async def play(self, files: Sequence[Path], excerpt: Excerpt, progress: Progress) -> PlaybackReport:
        """Publish the messages of all files at the times at which they came.

        Args:
            files: Of one recording, oldest first; of damaged ones, what can be read.
            excerpt: What of it.
            progress: Told the file, how many bytes have been played, and of how many.

        Raises:
            FileFormatError: One is no recording of PCMRS.
            ConfigurationError: A topic is no key expression.
            OSError: One cannot be read.
        """
        wanted, readings = TopicFilter(excerpt.topics), [RecordingReader(path) for path in files]
        total = sum(reading.size for reading in readings)
        begun, count, last = self._clock.monotonic(), 0, 0.0
        for since, heard, done, name in _timed(readings):
            if excerpt.end is not None and since > excerpt.end:
                break
            if since >= excerpt.begin and wanted(heard.key):
                await self._wait_until(begun + (since - excerpt.begin) / excerpt.rate)
                self._publish(heard)
                count, last = count + 1, since
                progress(name, done, total)
        return self._told(readings, count, last)

    async def close(self) -> None:
        """Leave the bus."""
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(None, self._undeclare)
        await loop.run_in_executor(None, self._session.close)

    async def _wait_until(self, due: float) -> None:
        await self._clock.sleep(max(0.0, due - self._clock.monotonic()))

    def _publish(self, heard: RawSample) -> None:
        if heard.key not in self._publishers:
            publisher = declare_publisher(self._session, f"{self.prefix}/{heard.key}", class_of(heard.key))
            self._publishers[heard.key] = publisher
        self._publishers[heard.key].put(heard.payload)

    def _told(self, readings: Sequence[RecordingReader], count: int, duration: float) -> PlaybackReport:
        damaged = [reading for reading in readings if reading.damage]
        return PlaybackReport(
            prefix=self.prefix,
            messages=count,
            duration=duration,
            lost_bytes=sum(reading.size - reading.whole for reading in damaged),
            damage=[f"{reading.path}: {reading.damage}" for reading in damaged],
        )

    def _is_live(self) -> bool:
        """Return whether a process of a running cell is connected under the prefix."""
        replies = self._session.liveliness().get(f"{self.prefix}/alive/**", timeout=_ASKING)
        return any(True for _ in replies)

    def _undeclare(self) -> None:
        for publisher in self._publishers.values():
            publisher.undeclare()


def _timed(readings: Sequence[RecordingReader]) -> Iterator[tuple[float, RawSample, int, str]]:
    """Messages in order: s since the first, the message, bytes read of all files until then, and the file's name."""
    first_ns, before = None, 0
    for reading in readings:
        for at_ns, heard in reading.bus_messages():
            first_ns = at_ns if first_ns is None else first_ns
            yield (at_ns - first_ns) / _SECOND, heard, before + reading.whole, reading.path.name
        before += reading.size


def read_cell_name(path: Path) -> str:
    """Name of the cell that a recording is of.

    Raises:
        FileFormatError: The file does not say; it is no recording of PCMRS.
        OSError: It cannot be read.
    """
    reading = RecordingReader(path)
    for _ in reading.records():
        if reading.origin:
            break
    if "cell" not in reading.origin:
        text = f"{path} does not say which cell it is of: it is no recording of pcmrs record, or was cut at its start."
        raise FileFormatError(text, file=str(path))
    return reading.origin["cell"]
