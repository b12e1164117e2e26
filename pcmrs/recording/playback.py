"""Playback of a recording on the bus, under a prefix that no cell uses."""

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
from pcmrs.recording.reader import RecordingReader, check_format
from pcmrs.recording.subscriber import RawSample
from pcmrs.recording.topics import TopicFilter

if TYPE_CHECKING:
    import zenoh

SITE: Final = "replay"
"""Site of all played cells: no robot subscribes to it."""

_ASKING = 1.0
_SECOND = 1_000_000_000

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Excerpt:
    """Part of a recording to be played, and its speed.

    Attributes:
        begin: Start, s since the first message.
        end: End, s since the first message; None for the end of the recording.
        topics: Key expressions of the topics; empty for all.
        rate: Seconds of the recording per second of the machine.
    """

    begin: float = 0.0
    end: float | None = None
    topics: tuple[str, ...] = ()
    rate: float = 1.0


class PlaybackReport(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of a playback.

    Attributes:
        prefix: Key prefix of the messages.
        messages: Number of messages.
        duration: Time from the recording's first message to the last one played, s.
        lost_bytes: Number of bytes of damaged files that could not be read.
        damage: Damage of the files, one line each.
    """

    prefix: str
    messages: int
    duration: float
    lost_bytes: int
    damage: list[str] = msgspec.field(default_factory=list)


class PlaybackPublisher:
    """Publisher of recordings on the bus. Use `PlaybackPublisher.open`.

    Attributes:
        prefix: Prefix of all keys.
    """

    def __init__(self, session: zenoh.Session, prefix: str, clock: Clock) -> None:
        self.prefix = prefix
        self._session = session
        self._clock = clock
        self._publishers: dict[str, Any] = {}

    @classmethod
    async def open(cls, endpoint: str, name: str, clock: Clock) -> PlaybackPublisher:
        """Connect to the bus, unless a daemon runs under the prefix.

        Args:
            endpoint: Endpoint of a running daemon's bus, or of another router.
            name: Name of the played cell; the prefix is ``pcmrs/replay/<name>``.
            clock: Clock of the machine.

        Raises:
            BusError: There is no answer at the endpoint.
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
        """Publish the messages of all files with their original timing.

        Args:
            files: Files of one recording, oldest first; a damaged one is played as far as it can be read.
            excerpt: Part to be played, and its speed.
            progress: Callback for the file name, the number of bytes played, and their total.

        Raises:
            FileFormatError: A file is not a recording of PCMRS, or a later version recorded it.
            ConfigurationError: A topic is not a key expression.
            OSError: A file cannot be read.
        """
        for path in files:
            check_format(path)
        wanted, readers = TopicFilter(excerpt.topics), [RecordingReader(path) for path in files]
        total = sum(reader.size for reader in readers)
        started_at, count, last = self._clock.monotonic(), 0, 0.0
        for since, sample, done, name in _timed(readers):
            if excerpt.end is not None and since > excerpt.end:
                break
            if since >= excerpt.begin and wanted(sample.key):
                await self._wait_until(started_at + (since - excerpt.begin) / excerpt.rate)
                self._publish(sample)
                count, last = count + 1, since
                progress(name, done, total)
        return self._report(readers, count, last)

    async def close(self) -> None:
        """Disconnect from the bus."""
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(None, self._undeclare)
        await loop.run_in_executor(None, self._session.close)

    async def _wait_until(self, due: float) -> None:
        await self._clock.sleep(max(0.0, due - self._clock.monotonic()))

    def _publish(self, sample: RawSample) -> None:
        if sample.key not in self._publishers:
            publisher = declare_publisher(self._session, f"{self.prefix}/{sample.key}", class_of(sample.key))
            self._publishers[sample.key] = publisher
        self._publishers[sample.key].put(sample.payload)

    def _report(self, readers: Sequence[RecordingReader], count: int, duration: float) -> PlaybackReport:
        damaged = [reader for reader in readers if reader.damage]
        return PlaybackReport(
            prefix=self.prefix,
            messages=count,
            duration=duration,
            lost_bytes=sum(reader.size - reader.whole for reader in damaged),
            damage=[f"{reader.path}: {reader.damage}" for reader in damaged],
        )

    def _is_live(self) -> bool:
        """Return whether a process of a running cell is connected under the prefix."""
        replies = self._session.liveliness().get(f"{self.prefix}/alive/**", timeout=_ASKING)
        return any(True for _ in replies)

    def _undeclare(self) -> None:
        for publisher in self._publishers.values():
            publisher.undeclare()


def _timed(readers: Sequence[RecordingReader]) -> Iterator[tuple[float, RawSample, int, str]]:
    """Yield time since the first message, s, the message, bytes read of all files until then, and the file's name."""
    first_ns, before = None, 0
    for reader in readers:
        for at_ns, sample in reader.bus_messages():
            first_ns = at_ns if first_ns is None else first_ns
            yield (at_ns - first_ns) / _SECOND, sample, before + reader.whole, reader.path.name
        before += reader.size


def read_cell_name(path: Path) -> str:
    """Return the name of the recorded cell.

    Raises:
        FileFormatError: The file does not name it: it is not a recording of PCMRS.
        OSError: The file cannot be read.
    """
    reader = RecordingReader(path)
    for _ in reader.records():
        if reader.origin:
            break
    if "cell" not in reader.origin:
        text = f"{path} does not name its cell: it is not a recording of pcmrs record, or was cut at its start."
        raise FileFormatError(text, file=str(path))
    return reader.origin["cell"]
