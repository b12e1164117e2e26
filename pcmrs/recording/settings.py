"""What is recorded by default, and how much of the disk it may take."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.recording.series import Limits
from pcmrs.recording.topics import TOPICS

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
MEGABYTE = 1_000_000
FOLDER = "recordings"
"""Where the recordings of all sessions of a cell lie, in the cell's folder."""


class RecordingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the daemon records each of its sessions, by a process of its own.

    Attributes:
        enabled: Whether it does.
        file_mb: A file of about this size is followed by the next one, 1e6 bytes.
        total_mb: Of all sessions' files of a cell together; beyond it the oldest are removed.
        file_s: A file is followed by the next one after this time, s.
        keep_free_mb: The recording ends rather than leave less than this on the disk: the journal needs room.
        topics: Key expressions of what is recorded, relative to the cell; none may lie within another one.
    """

    enabled: bool = True
    file_mb: Positive = 512.0
    total_mb: Positive = 4096.0
    file_s: Positive = 86_400.0
    keep_free_mb: Annotated[float, msgspec.Meta(ge=0.0)] = 256.0
    topics: tuple[str, ...] = TOPICS

    def limits(self) -> Limits:
        """The same as the recorder counts them."""
        return Limits(
            file_bytes=self.file_mb * MEGABYTE,
            file_s=self.file_s,
            total_bytes=self.total_mb * MEGABYTE,
            keep_free_bytes=self.keep_free_mb * MEGABYTE,
        )
