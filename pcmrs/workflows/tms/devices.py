"""The devices that a procedure with stimulation needs beside robot and tracker; a cell need not have them."""

from __future__ import annotations

from pcmrs.devices.protocols import Emg, Stimulator
from pcmrs.dispatcher import Registry
from pcmrs.errors import RefusalError
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.tms.data import Run


def stimulator_of(cell: Cell) -> Stimulator:
    """The cell's stimulator. Raises `RefusalError` where there is none."""
    if cell.stimulator is None:
        text = "There is no stimulator: set stimulator.driver, such as sim or trigger, and restart the daemon."
        raise RefusalError("no_stimulator", text)
    return cell.stimulator


def emg_of(cell: Cell) -> Emg:
    """The cell's electromyograph. Raises `RefusalError` where there is none."""
    if cell.emg is None:
        text = "There is no electromyograph: set emg.driver, such as sim or lsl, and restart the daemon."
        raise RefusalError("no_emg", text)
    return cell.emg


def stimulator_there(run: Run) -> None:
    """Refuses without a stimulator."""
    stimulator_of(run.cell)


def emg_there(run: Run) -> None:
    """Refuses without an electromyograph: nothing could be learned from the pulse."""
    emg_of(run.cell)


def register_device_checks(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for these checks."""
    for check in (stimulator_there, emg_there):
        registry.check(check)
