"""Opening the simulated cell in this process: its devices, and virtual ones for drivers of real devices."""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection, Mapping
from contextlib import asynccontextmanager
from typing import Any

from pcmrs.clock import Clock
from pcmrs.errors import ConfigurationError
from pcmrs_sim.cell import CellSimulation, running_cell
from pcmrs_sim.serving import serve_virtual


@asynccontextmanager
async def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AsyncIterator[Mapping[str, Any]]:
    """Open devices of a simulated cell in this process; see `pcmrs.devices.protocols.OpenDriver`.

    Args:
        devices: Names among ``robot``, ``tracker``, ``pointer``, ``scene``, ``stimulator`` and ``emg``.
        settings: The whole configuration; ``sim`` and ``robot`` are read.
        clock: The cell's clock.

    Raises:
        ConfigurationError: A device or the arm is unknown, or the table ``sim`` is wrong.
    """
    async with open_cell(devices, settings, clock) as cell:
        yield {name: cell.devices[name] for name in devices}


@asynccontextmanager
async def open_cell(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AsyncIterator[CellSimulation]:
    """Open a running cell that serves the virtual devices of the settings, too.

    Args:
        devices: Names of devices that the cell must have, see `open_devices`.
        settings: The whole configuration.
        clock: The cell's clock.

    Raises:
        ConfigurationError: A device or the arm is unknown, or the table ``sim`` is wrong.
    """
    async with running_cell(settings, clock) as cell, serve_virtual(cell, settings):
        unknown = sorted(set(devices) - set(cell.devices))
        if unknown:
            raise ConfigurationError(
                f"The simulated cell has no {', '.join(unknown)}; it has {', '.join(cell.devices)}.", unknown=unknown
            )
        yield cell
