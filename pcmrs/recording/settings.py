"""Settings of the daemon's recordings."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.recording.series import Limits
from pcmrs.recording.topics import TOPICS

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
MEGABYTE = 1_000_000
FOLDER = "recordings"
"""Folder of the recordings of all sessions, in the cell's folder."""


class RecordingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Recording of each session of the daemon, by its own process.

    Attributes:
        enabled: True to record.
        file_mb: Approximate size at which the next file starts, 1e6 bytes.
        total_mb: Size of all sessions' files of a cell together, beyond which the oldest are removed, 1e6 bytes.
        file_s: Duration after which the next file starts, s.
        keep_free_mb: Free space below which the recording ends, 1e6 bytes: the journal needs room.
        topics: Key expressions of the recorded topics, relative to the cell; they must not overlap.
    """

    enabled: bool = True
    file_mb: Positive = 512.0
    total_mb: Positive = 4096.0
    file_s: Positive = 86_400.0
    keep_free_mb: Annotated[float, msgspec.Meta(ge=0.0)] = 256.0
    topics: tuple[str, ...] = TOPICS

    def limits(self) -> Limits:
        """Return the limits in bytes."""
        return Limits(
            file_bytes=self.file_mb * MEGABYTE,
            file_s=self.file_s,
            total_bytes=self.total_mb * MEGABYTE,
            keep_free_bytes=self.keep_free_mb * MEGABYTE,
        )
