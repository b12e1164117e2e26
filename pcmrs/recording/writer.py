"""Recording a cell, until it is told to end or the disk has no room left."""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from foxglove.messages import LogLevel

from pcmrs.clock import Clock
from pcmrs.errors import PcmrsError
from pcmrs.messages import DeviceEvent, Message
from pcmrs.recording.file import RecordingFile, Topics
from pcmrs.recording.series import Limits, path_of, remove_oldest
from pcmrs.recording.shapes import line
from pcmrs.recording.subscriber import RawSample, Subscriber
from pcmrs.recording.views import LOG, RecordingViews

PERIOD: Final = 0.05
"""Between two looks at what has come, s: the fewer, the less it costs."""

SETTLED: Final = 1.0
"""So often what was written is made to survive the end of this process, and the limits are looked at, s."""

_SECOND = 1_000_000_000
_log = logging.getLogger(__name__)


class RecordingError(PcmrsError):
    """A recording cannot go on: the disk is full, or a file cannot be written."""

    code = "recording_ended"


class RecordingReport(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What a recording came to.

    Attributes:
        files: That are left of it, oldest first.
        removed: So many were removed to keep within the limit.
        messages: Heard on the bus and written.
        dropped: Heard, but too many at a time to be written.
        duration: s of the machine.
        error: Why it ended before it was told to; None where it did not.
    """

    files: list[str]
    removed: int
    messages: int
    dropped: int
    duration: float
    error: str | None = None


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """What to write where.

    Attributes:
        first: Name of the recording.
        limits: Of its files.
        origin: What every file says of itself: cell, session, versions.
        pool: The files, oldest first, that `limits.total_bytes` is about.
    """

    first: Path
    limits: Limits
    origin: dict[str, str]
    pool: Callable[[], list[Path]]


class RecordingWriter:
    """Writes what a tap hears.

    Times of messages are those of the monotonic clock, counted from the wall's time at the start: they never jump. What
    the wall's clock said is in each file's metadata.

    Args:
        plan: What to write where.
        views: Translates for people.
        clock: Of the machine.

    Attributes:
        messages: So many have been written until now.

    Raises:
        OSError: The first file cannot be made.
    """

    def __init__(self, plan: RecordingPlan, views: RecordingViews, clock: Clock) -> None:
        self._plan, self._views, self._clock = plan, views, clock
        self._begun = self._settled = clock.monotonic()
        self._begun_ns = int(clock.wall() * _SECOND)
        self._topics = Topics()
        self.messages = self._number = self._removed = self._dropped = 0
        self._file = self._next_file()

    async def run(self, tap: Subscriber, ended: asyncio.Event) -> RecordingReport:
        """Record until `ended` is set, or nothing more can be written: then the daemon is told why.

        Args:
            tap: What to record; its rest is written, too.
            ended: Ends the recording.
        """
        error, told = None, False
        while error is None and not told:
            await self._clock.sleep(PERIOD)
            told = ended.is_set()  # before the last look: what came until then is written
            error = self._work(tap)
        if error is not None:
            _log.error("recording_ended %s", error.text)
            await tap.report(DeviceEvent(device="recorder", code=error.code, text=error.text, fields=error.fields))
        error = self._close() or error
        return RecordingReport(
            files=[str(path) for path in self._plan.pool() if path.exists()],
            removed=self._removed,
            messages=self.messages,
            dropped=self._dropped,
            duration=self._clock.monotonic() - self._begun,
            error=None if error is None else error.text,
        )

    def _work(self, tap: Subscriber) -> RecordingError | None:
        """Write what has come; returns why it cannot go on."""
        for heard in tap.heard():
            self._write(heard)
        if tap.dropped > self._dropped:
            self._say(f"{tap.dropped - self._dropped} messages were dropped: they came faster than they were written.")
            self._dropped = tap.dropped
        try:
            return self._trouble() or self._rotate() or self._settle()
        except OSError as error:
            return self._failed(error)

    def _write(self, heard: RawSample) -> None:
        at_ns = self._ns(heard.at)
        self._topics.write_raw(heard.key, heard.at, heard.payload, at_ns)
        for topic, view in self._views.of(heard, at_ns):
            self._topics.write(topic, view, at_ns)
        self.messages += 1

    def _rotate(self) -> RecordingError | None:
        """Start the next file where it is due. Raises `OSError`."""
        limits = self._plan.limits
        age = self._clock.monotonic() - self._opened
        too_long = limits.file_s is not None and age >= limits.file_s
        if not too_long and (limits.file_bytes is None or self._file.size < limits.file_bytes):
            return None
        self._file.close()
        if error := self._trouble():
            return error
        self._file = self._next_file()
        return None

    def _settle(self) -> RecordingError | None:
        """Now and then: makes what was written survive, and looks at what the disk holds. Raises `OSError`."""
        now = self._clock.monotonic()
        if now - self._settled < SETTLED:
            return None
        self._settled = now
        self._file.flush()
        limits = self._plan.limits
        if limits.total_bytes is not None:
            remove_oldest(self._plan.pool(), limits.total_bytes, self._tell_removed)
        free = shutil.disk_usage(self._file.path.parent).free
        if free < limits.keep_free_bytes:
            text = f"Only {free / 1e6:.0f} MB are free, {limits.keep_free_bytes / 1e6:.0f} MB are kept for the journal"
            return RecordingError(f"{text}: the recording ends. Make room, then restart.", free=free)
        return None

    def _next_file(self) -> RecordingFile:
        """Raises `OSError`."""
        self._number += 1
        self._opened = self._clock.monotonic()
        plan = self._plan
        path = path_of(plan.first, self._number) if plan.limits.numbered else plan.first
        opened = RecordingFile(path, self._topics, plan.origin | self._times())
        at_ns = self._ns(self._opened)
        for topic, view in self._views.opening(at_ns):
            self._topics.write(topic, view, at_ns)
        _log.info("recording %s", path)
        return opened

    def _times(self) -> dict[str, str]:
        """The clocks when a file begins, s."""
        now = self._clock.monotonic()
        return {
            "monotonic": repr(now),
            "wall": repr(self._clock.wall()),
            "log_time_ns": str(self._ns(now)),
            "file": str(self._number),
        }

    def _tell_removed(self, path: Path, size: int) -> None:
        self._removed += 1
        self._say(f"{path.name} ({size / 1e6:.1f} MB) was removed: together the files were larger than allowed.")

    def _say(self, text: str) -> None:
        _log.warning("recorder %s", text)
        at_ns = self._ns(self._clock.monotonic())
        self._topics.write(LOG, line(LogLevel.Warning, "recorder", text, at_ns), at_ns)

    def _ns(self, monotonic: float) -> int:
        return self._begun_ns + int((monotonic - self._begun) * _SECOND)

    def _trouble(self) -> RecordingError | None:
        return None if self._file.error is None else self._failed(self._file.error)

    def _failed(self, error: OSError) -> RecordingError:
        text = f"{self._file.path} cannot be written: {error.strerror or error}. The recording ends; see to the disk."
        return RecordingError(text, file=str(self._file.path))

    def _close(self) -> RecordingError | None:
        self._file.close()
        return self._trouble()
