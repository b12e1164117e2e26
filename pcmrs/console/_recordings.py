"""The recordings that can be replayed, each read once for all pages, in a thread."""

from __future__ import annotations

import asyncio
from pathlib import Path

from nicegui import background_tasks

from pcmrs.console.playback import LoadedRecording, load_recording
from pcmrs.errors import PcmrsError
from pcmrs.recording.series import recordings_in


class Recordings:
    """Recordings in a folder; one of them is kept in memory.

    Args:
        folder: Their folder; None for none.

    Attributes:
        progress: Share of the present recording that has been read.
        trouble: Reason why the last one could not be read; empty if it could.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._name = ""
        self._read: LoadedRecording | None = None
        self._reading: asyncio.Task[None] | None = None
        self.progress = 0.0
        self.trouble = ""

    def names(self) -> list[str]:
        """Return the names, newest first if they begin with their date."""
        return [] if self._folder is None else sorted(recordings_in(self._folder), reverse=True)

    def get(self, name: str) -> LoadedRecording | None:
        """Return one of `names`; None while it is being read, which starts now, and if that failed."""
        if name != self._name or self.trouble:
            if self._reading is not None:
                self._reading.cancel()
            self._name, self._read, self.progress, self.trouble = name, None, 0.0, ""
            self._reading = background_tasks.create(self._open(name), name=f"read {name}")
        return self._read

    @property
    def is_read(self) -> bool:
        """The recording that was requested last is available."""
        return self._read is not None

    async def _open(self, name: str) -> None:
        files = recordings_in(self._folder).get(name) if self._folder is not None else None
        if files is None:
            self.trouble = f"There is no recording {name}."
            return
        try:
            read = await asyncio.to_thread(load_recording, files, self._set_progress)
        except (PcmrsError, OSError) as error:
            self.trouble = str(error)
        else:
            self._read = read if name == self._name else None

    def _set_progress(self, share: float) -> None:
        self.progress = share
