"""Cell and clock of a replay: only the configuration is known; any use of devices, frames or time raises an error."""

from __future__ import annotations

import asyncio
from contextlib import AbstractAsyncContextManager, nullcontext
from typing import Any

from pcmrs.journal import JournalRow
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import ProcedureSettings


class NotJournalledError(Exception):
    """A check or step needs a measurement; the journal holds its result, not the measurement.

    It is not a `PcmrsError`, so that code that handles refusals does not catch it.
    """


_WORKED_OUT = ("calibration_id", "calibrations")
"""Attributes that a cell computes from others; they are known only if those are."""


class ReplayCell(Cell):
    """Cell of a replay: settings and calibrated poses are known, everything else was not journalled.

    Args:
        settings: Journalled settings of the procedure.
        calibration: Journalled identity of the calibrations; None if it is unknown.
    """

    def __init__(self, settings: ProcedureSettings, calibration: str | None) -> None:
        poses = settings.calibration
        known: dict[str, Any] = {"settings": settings}
        if not (poses.tool_file or poses.tip_file or poses.pointer_file):  # the journal does not contain these files
            known["mounting"] = Mounting.read(poses)
        if calibration is not None:
            known["calibration_id"] = calibration
        self._known = known

    def __getattribute__(self, name: str) -> Any:
        if name.startswith("_"):
            return super().__getattribute__(name)
        if name in self._known:
            return self._known[name]
        if name in _WORKED_OUT:
            return super().__getattribute__(name)
        raise NotJournalledError(name)


class RowsClock:
    """Implementation of `pcmrs.clock.Clock` for the dispatcher: it shows the time of a row.

    No deadline expires, and no timer: the rows have what followed from those that did.
    """

    def __init__(self) -> None:
        self._monotonic = self._wall = 0.0

    def show(self, row: JournalRow) -> None:
        """Set the time to that of a row."""
        self._monotonic, self._wall = row.monotonic, row.wall

    def monotonic(self) -> float:
        return self._monotonic

    def wall(self) -> float:
        return self._wall

    async def sleep(self, seconds: float) -> None:  # noqa: ARG002 (it ends when it is cancelled)
        await asyncio.get_running_loop().create_future()

    def timeout(self, seconds: float) -> AbstractAsyncContextManager[Any]:  # noqa: ARG002 (what waits is ended by rows)
        return nullcontext()


class ReplayClock(RowsClock):
    """Clock for checks and steps: the time at which they read it was not journalled."""

    def monotonic(self) -> float:
        raise NotJournalledError("monotonic")

    def wall(self) -> float:
        raise NotJournalledError("wall")

    async def sleep(self, seconds: float) -> None:
        raise NotJournalledError(f"sleep of {seconds} s")
