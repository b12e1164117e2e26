"""Writer of the recording of a cell, until it is stopped or the disk is full."""

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
from pcmrs.recording._foxglove_messages import line
from pcmrs.recording.file import RecordingFile, Topics
from pcmrs.recording.series import Limits, path_of, remove_oldest
from pcmrs.recording.subscriber import RawSample, Subscriber
from pcmrs.recording.views import LOG, RecordingViews

PERIOD: Final = 0.2
"""Period at which new messages are written, s; a longer one costs less."""

MAINTENANCE_PERIOD: Final = 1.0
"""Period at which data is flushed, so that it survives the end of this process, and the limits are checked, s."""

_SECOND = 1_000_000_000
_log = logging.getLogger(__name__)


class RecordingError(PcmrsError):
    """A recording cannot continue: the disk is full, or a file cannot be written."""

    code = "recording_ended"


class RecordingReport(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of a recording.

    Attributes:
        files: Remaining files, oldest first.
        removed: Number of files removed to keep within the limit.
        messages: Number of received and written messages.
        dropped: Number of received messages that came too fast to be written.
        duration: Duration, s of the machine.
        error: Reason why it ended early; None if it was stopped.
    """

    files: list[str]
    removed: int
    messages: int
    dropped: int
    duration: float
    error: str | None = None


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """Files of a recording to be made.

    Attributes:
        first: Name of the recording.
        limits: Limits of its files.
        origin: Metadata of each file: cell, session, versions.
        pool: Returns the files, oldest first, to which `limits.total_bytes` applies.
    """

    first: Path
    limits: Limits
    origin: dict[str, str]
    pool: Callable[[], list[Path]]


class RecordingWriter:
    """Writer of the messages of a subscriber.

    Times of messages are those of the monotonic clock, counted from the wall time at the start, so that they never
    jump. The wall time is in each file's metadata.

    Args:
        plan: Files to be written.
        views: Translator of messages into views for people.
        clock: Clock of the machine.

    Attributes:
        messages: Number of messages written until now.

    Raises:
        OSError: The first file cannot be created.
    """

    def __init__(self, plan: RecordingPlan, views: RecordingViews, clock: Clock) -> None:
        self._plan, self._views, self._clock = plan, views, clock
        self._started_at = self._maintained_at = clock.monotonic()
        self._started_at_ns = int(clock.wall() * _SECOND)
        self._topics = Topics()
        self.messages = self._number = self._removed = self._dropped = 0
        self._file = self._next_file()

    async def run(self, subscriber: Subscriber, ended: asyncio.Event) -> RecordingReport:
        """Record until `ended` is set; if nothing more can be written, report the reason to the daemon and stop.

        Args:
            subscriber: Source of the messages; those that wait at the end are written, too.
            ended: Event that ends the recording.
        """
        error, ending = None, False
        while error is None and not ending:
            await self._clock.sleep(PERIOD)
            ending = ended.is_set()  # read before the last pass, which writes all messages until then
            error = self._write_new(subscriber)
        if error is not None:
            _log.error("recording_ended %s", error.text)
            event = DeviceEvent(device="recorder", code=error.code, text=error.text, fields=error.fields)
            await subscriber.report(event)
        error = self._close() or error
        return RecordingReport(
            files=[str(path) for path in self._plan.pool() if path.exists()],
            removed=self._removed,
            messages=self.messages,
            dropped=self._dropped,
            duration=self._clock.monotonic() - self._started_at,
            error=None if error is None else error.text,
        )

    def _write_new(self, subscriber: Subscriber) -> RecordingError | None:
        """Write the new messages; return the reason if the recording cannot continue."""
        for sample in subscriber.take():
            self._write(sample)
        if subscriber.dropped > self._dropped:
            new = subscriber.dropped - self._dropped
            self._warn(f"{new} messages were dropped: they came faster than they were written.")
            self._dropped = subscriber.dropped
        try:
            return self._file_error() or self._rotate() or self._maintain()
        except OSError as error:
            return self._failed(error)

    def _write(self, sample: RawSample) -> None:
        at_ns = self._ns(sample.at)
        self._topics.write_raw(sample.key, sample.at, sample.payload, at_ns)
        for topic, view in self._views.of(sample, at_ns):
            self._topics.write(topic, view, at_ns)
        self.messages += 1

    def _rotate(self) -> RecordingError | None:
        """Start the next file if it is due. Raises `OSError`."""
        limits = self._plan.limits
        age = self._clock.monotonic() - self._opened
        too_long = limits.file_s is not None and age >= limits.file_s
        if not too_long and (limits.file_bytes is None or self._file.size < limits.file_bytes):
            return None
        self._file.close()
        if error := self._file_error():
            return error
        self._file = self._next_file()
        self._remove_oldest()
        return None

    def _maintain(self) -> RecordingError | None:
        """Flush and check the limits, once per `MAINTENANCE_PERIOD`. Raises `OSError`."""
        now = self._clock.monotonic()
        if now - self._maintained_at < MAINTENANCE_PERIOD:
            return None
        self._maintained_at = now
        self._file.flush()
        self._remove_oldest()
        limits = self._plan.limits
        free = shutil.disk_usage(self._file.path.parent).free
        if free < limits.keep_free_bytes:
            text = f"Only {free / 1e6:.0f} MB are free, {limits.keep_free_bytes / 1e6:.0f} MB are kept for the journal"
            return RecordingError(f"{text}: the recording ends. Make room, then restart.", free=free)
        return None

    def _next_file(self) -> RecordingFile:
        """Open the next file. Raises `OSError`."""
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
        """Return the clocks at the start of a file, s."""
        now = self._clock.monotonic()
        return {
            "monotonic": repr(now),
            "wall": repr(self._clock.wall()),
            "log_time_ns": str(self._ns(now)),
            "file": str(self._number),
        }

    def _remove_oldest(self) -> None:
        limits = self._plan.limits
        if limits.total_bytes is not None:
            remove_oldest(self._plan.pool(), limits.total_bytes, self._log_removed)

    def _log_removed(self, path: Path, size: int) -> None:
        self._removed += 1
        self._warn(f"{path.name} ({size / 1e6:.1f} MB) was removed: together the files were larger than allowed.")

    def _warn(self, text: str) -> None:
        _log.warning("recorder %s", text)
        at_ns = self._ns(self._clock.monotonic())
        self._topics.write(LOG, line(LogLevel.Warning, "recorder", text, at_ns), at_ns)

    def _ns(self, monotonic: float) -> int:
        return self._started_at_ns + int((monotonic - self._started_at) * _SECOND)

    def _file_error(self) -> RecordingError | None:
        return None if self._file.error is None else self._failed(self._file.error)

    def _failed(self, error: OSError) -> RecordingError:
        text = f"{self._file.path} cannot be written: {error.strerror or error}. The recording ends; see to the disk."
        return RecordingError(text, file=str(self._file.path))

    def _close(self) -> RecordingError | None:
        self._file.close()
        return self._file_error()
