"""A cell of which only the configuration is left: whoever looks at its devices, frames or clock is told so."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager, nullcontext
from typing import Any

from pcmrs.journal import JournalRow
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.settings import ProcedureSettings


class NotJournalledError(Exception):
    """A check or step has looked at the world, of which the journal holds what came of it, not what was seen.

    No `PcmrsError`: what handles refusals must not take it for one.
    """


_WORKED_OUT = ("calibration_id", "calibrations")
"""What a cell works out from the attributes that are known; where they are not, neither is this."""


class ReplayCell(Cell):
    """Stands for the cell in a replay: settings and calibrated poses are known, everything else is not recorded.

    Args:
        settings: Of the procedure, as recorded.
        calibration: Identity of the calibrations, as recorded; None where that is not known.
    """

    def __init__(self, settings: ProcedureSettings, calibration: str | None) -> None:
        poses = settings.calibration
        known: dict[str, Any] = {"settings": settings}
        if not (poses.tool_file or poses.pointer_file):  # those files are not in the journal
            known |= {"tool_calibration": None, "pointer_calibration": None}
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
    """Implements `pcmrs.clock.Clock` for the dispatcher: it shows the time of a row, and no deadline ever passes."""

    def __init__(self) -> None:
        self._monotonic = self._wall = 0.0

    def show(self, row: JournalRow) -> None:
        """Go to the time at which the row was written."""
        self._monotonic, self._wall = row.monotonic, row.wall

    def monotonic(self) -> float:
        return self._monotonic

    def wall(self) -> float:
        return self._wall

    async def sleep(self, seconds: float) -> None:
        raise NotJournalledError(f"sleep of {seconds} s")

    def timeout(self, seconds: float) -> AbstractAsyncContextManager[Any]:  # noqa: ARG002 (what waits is ended by rows)
        return nullcontext()


class ReplayClock(RowsClock):
    """The same for checks and steps: at which moment they looked at it is not on record."""

    def monotonic(self) -> float:
        raise NotJournalledError("monotonic")

    def wall(self) -> float:
        raise NotJournalledError("wall")
