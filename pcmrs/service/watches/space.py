"""Watch of the free space for the journal: an early warning, and no state changes before the disk is full."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Final

from pcmrs.clock import Clock
from pcmrs.messages import DeviceEvent, Reason
from pcmrs.messages.health import Room

PERIOD: Final = 1.0
"""Period of the checks, s of the machine."""
MEGABYTE: Final = 1e6
REMEDY: Final = "Make room on the disk of cell.folder"


class SpaceWatch:
    """Watch over the free space on the journal's disk.

    A full disk makes the journal fail, which stops running operations. Therefore state changes are refused while there
    is still room for the outcomes of running operations, for events, for every Stop, and for a retreat.

    Args:
        folder: Folder of the journal.
        warn: Free space below which it warns, MB.
        least: Free space below which commands are refused, MB.
        suspend: `Dispatcher.suspend`.
        report: Takes an event when the room has changed.
        clock: The machine's clock.

    Attributes:
        free: Free space at the last check, MB; None before the first one.
        room: Verdict on it.
    """

    def __init__(
        self,
        folder: Path,
        warn: float,
        least: float,
        suspend: Callable[[Reason | None], None],
        report: Callable[[DeviceEvent], None],
        clock: Clock,
    ) -> None:
        self.free: float | None = None
        self.room: Room = "enough"
        self._folder, self._warn, self._least = folder, warn, least
        self._suspend, self._report, self._clock = suspend, report, clock

    async def run(self) -> None:
        """Watch until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            # A disk may take long to answer.
            self.take((await loop.run_in_executor(None, shutil.disk_usage, self._folder)).free / MEGABYTE)
            await self._clock.sleep(PERIOD)

    def take(self, free: float) -> None:
        """Judge the free space, MB."""
        self.free = free
        before, self.room = self.room, self._judged(free)
        if self.room == before:
            return
        text = f"{free:.0f} MB are free on the disk of {self._folder}"
        fields = {"free_mb": free, "warn_free_mb": self._warn, "least_free_mb": self._least}
        if self.room == "none":
            text = f"{text}, and below {self._least:g} MB no state change is accepted but retreats and the release of "
            text += f"Stop. {REMEDY}; Stop still works."
            self._suspend(Reason(code="disk_full", text=text, fields=fields))
        else:
            self._suspend(None)
        if self.room == "little":
            text = f"{text}; below {self._least:g} MB no state change is accepted. {REMEDY}."
        code = {"none": "disk_full", "little": "disk_filling", "enough": "disk_has_room"}[self.room]
        self._report(DeviceEvent(device="daemon", code=code, text=text, fields=fields))

    def _judged(self, free: float) -> Room:
        return "none" if free < self._least else "little" if free < self._warn else "enough"
