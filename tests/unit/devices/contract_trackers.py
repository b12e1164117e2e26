"""The trackers of which the contract of `TrackerDriver` is tested: each sees the same simulated cell."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers import ndi
from pcmrs.devices.protocols import TrackerDriver
from pcmrs_sim.cell import CellSimulation, running_cell
from pcmrs_sim.ndi.server import serve_ndi, serve_ndi_pty

WITHOUT_DYNAMICS = {"sim": {"arm": {"physics": "kinematic"}}}

OpenTracker = Callable[[], AbstractAsyncContextManager[tuple[TrackerDriver, CellSimulation]]]


@asynccontextmanager
async def simulated() -> AsyncIterator[tuple[TrackerDriver, CellSimulation]]:
    """The tracker of the cell itself."""
    async with running_cell(WITHOUT_DYNAMICS, SystemClock()) as cell:
        yield cell.devices["tracker"], cell  # type: ignore[misc]


@asynccontextmanager
async def ndi_on_network() -> AsyncIterator[tuple[TrackerDriver, CellSimulation]]:
    """The NDI driver, its reader process, and the virtual tracker on a TCP port."""
    async with (
        running_cell(WITHOUT_DYNAMICS, SystemClock()) as cell,
        serve_ndi(cell) as (host, port),
        _ndi(f"{host}:{port}") as found,
    ):
        yield found, cell


@asynccontextmanager
async def ndi_on_serial_line() -> AsyncIterator[tuple[TrackerDriver, CellSimulation]]:
    """The same on a pseudo-terminal."""
    async with running_cell(WITHOUT_DYNAMICS, SystemClock()) as cell, serve_ndi_pty(cell) as path, _ndi(path) as found:
        yield found, cell


@asynccontextmanager
async def _ndi(device: str) -> AsyncIterator[TrackerDriver]:
    async with ndi.open_devices(("tracker",), {"ndi": {"device": device}}, SystemClock()) as devices:
        yield devices["tracker"]


TRACKERS: dict[str, OpenTracker] = {
    "sim": simulated,
    "ndi-network": ndi_on_network,
    "ndi-serial": ndi_on_serial_line,
}
"""By name; a new driver is added here."""
