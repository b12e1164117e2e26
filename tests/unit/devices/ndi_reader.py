"""A simulated tracker, the NDI driver at it, and the reader processes that it has started, for tests."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Sequence
from contextlib import aclosing, asynccontextmanager
from pathlib import Path
from typing import Any

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers.ndi import NdiTracker, open_devices
from pcmrs.devices.ndi.process import MODULE
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform
from pcmrs_sim.cell import CellSimulation, running_cell
from pcmrs_sim.ndi.server import serve_ndi

DEADLINE = 30.0


@asynccontextmanager
async def ndi_tracker(**table: Any) -> AsyncIterator[NdiTracker]:
    async with asyncio.timeout(DEADLINE), open_devices(("tracker",), {"ndi": table}, SystemClock()) as devices:
        yield devices["tracker"]


async def frames_of(tracker: NdiTracker, count: int) -> list[Sequence[BodyPose]]:
    async with aclosing(tracker.frames()) as frames:
        return [await anext(frames) for _ in range(count)]


def readers() -> list[int]:
    """Process ids of the reader processes that this test has begun."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                command, parent = (
                    (entry / "cmdline").read_bytes(),
                    (entry / "stat").read_text().rsplit(")")[1].split()[1],
                )
            except OSError:
                continue
            if MODULE.encode() in command and int(parent) == os.getpid():
                found.append(int(entry.name))
    return found


def true_marker(cell: CellSimulation) -> Transform:
    """Where the marker body of the tool truly is in the tracker."""
    found = cell.world.tracker_from("coil")
    assert found is not None
    return found


@asynccontextmanager
async def served_ndi() -> AsyncIterator[tuple[CellSimulation, str]]:
    async with running_cell({}, SystemClock()) as cell, serve_ndi(cell) as (host, port):
        yield cell, f"{host}:{port}"
