"""Nothing is measured or moved by a calibration that is expired, of something else, or changed."""

from __future__ import annotations

from pcmrs.calibration import Expected, check_valid
from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

Run = AnyRun[Cell, PlacementData]


def calibration_valid(run: Run) -> None:
    """Refuses where a configured calibration file must not be used; poses given in the configuration do not expire.

    Raises:
        RefusalError: Tool or pointer: see `check_valid`.
    """
    cell, settings = run.cell, run.cell.settings
    run.result["calibration"] = cell.calibrations()
    serials = {"tool": settings.calibration.tool_serial, "pointer": settings.calibration.pointer_serial}
    for calibration in (cell.tool_calibration, cell.pointer_calibration):
        if calibration is not None:
            expected = Expected(cell.name, settings.tool, serials[calibration.kind])
            check_valid(calibration, expected, run.clock.wall())


def register_calibration_checks(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the name that blueprints use for this check."""
    registry.check(calibration_valid)
