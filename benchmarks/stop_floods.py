"""Stop during a flood: the time until it has begun, for a press by UDP and one over the bus.

Each kind of flood has a separate daemon, on the simulated cell at real time, and one process that floods as one user
without the lease. The daemon of the first kind is measured without a flood before. The time of a press is from the call
to the event that names its source, as this process receives it, or to its answer, if that is earlier: the latch is set
and the holds are sent before. If many users press, several presses are reported as one, and only the answer remains.

The kinds `udp`, `tcp` and `tls` flood the planner's UDP socket, at which Stop is also pressed, the TCP link and the TLS
port. `uploads` sends files to a console.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final

from stop_found import DURING, TIMER, Found

from pcmrs.errors import PcmrsError
from pcmrs.messages import DeviceEvent
from pcmrs.testing.cell import REAL_TIME, RunningCell, open_cell
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import register
from pcmrs_lab.campaign.bus_flood import FLOODER, KINDS, bus_flood
from pcmrs_lab.campaign.connection_flood import connection_flood
from pcmrs_lab.campaign.consoles import running_console
from pcmrs_lab.campaign.flood import flood
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.lateness import timer_lateness
from pcmrs_lab.campaign.reachable import reachable_cell
from pcmrs_lab.campaign.uploading import Uploader, uploader

FLOODS: Final = (*KINDS, "udp", "tcp", "tls", "uploads")
NO_FLOOD = "no flood"
AT_THE_SOCKET = "asked to begun, at the flooded UDP socket"
"""The only measurement without a limit: a socket that is flooded loses presses, and the planner repeats them."""
APART = 0.05
"""Time between a Stop that has begun and the next press, s."""
PATIENCE = 5.0
DATAGRAMS = 40_000.0
"""Rate of the flood of datagrams, 1/s."""
FILE = bytes(10**6)
UPLOADS = 4
"""Number of files that are uploaded at the same time."""

Rate = Callable[[], float]


async def flooded(stops: int, kinds: Sequence[str]) -> Found:
    """Press Stop by each route during each kind of flood, and without one.

    Args:
        stops: Number of presses by each route.
        kinds: Kinds of floods, at least one of `FLOODS`.

    Returns:
        Results.
    """
    found = Found()
    for kind in kinds:
        with tempfile.TemporaryDirectory(prefix="pcmrs-", ignore_cleanup_errors=True) as folder:
            async with _opened(kind, Path(folder)) as (cell, address):
                await register(cell.client)
                if kind == kinds[0]:
                    await _measure(cell, NO_FLOOD, stops, found)
                async with _flooding(cell, address, kind) as rate:
                    await _measure(cell, kind, stops, found)
                found.notes[f"messages per second of {kind}"] = round(rate())
    return found


@asynccontextmanager
async def _opened(kind: str, folder: Path) -> AsyncIterator[tuple[RunningCell, tuple[str, int]]]:
    """Start a cell for a kind of flood; yield it with the address that a flood of connections uses."""
    if kind == "tls":
        async with reachable_cell(Lab(1, folder), *REAL_TIME) as reached, reached.cell.client.holding():
            yield reached.cell, reached.address
        return
    async with open_cell(folder / "flooded", REAL_TIME) as cell:
        yield cell, cell.ready.links["tcp"]


@asynccontextmanager
async def _flooding(cell: RunningCell, address: tuple[str, int], kind: str) -> AsyncIterator[Rate]:
    """Flood a cell for the length of the context; yield the rate, 1/s, which is complete afterwards."""
    if kind in KINDS:
        async with bus_flood(kind, cell.ready.endpoint, cell.name) as on_the_bus:
            yield lambda: on_the_bus.report.rate
    elif kind == "udp":
        async with flood(cell.ready.links["planner"], DATAGRAMS, 1) as datagrams:
            yield lambda: datagrams.rate
    elif kind == "uploads":
        async with _uploading(cell) as rate:
            yield rate
    else:
        async with connection_flood(address, tls=kind == "tls") as connections:
            yield lambda: connections.rate


@asynccontextmanager
async def _uploading(cell: RunningCell) -> AsyncIterator[Rate]:
    """Send files to a console for the length of the context."""
    sent: list[float] = []

    async def send(own: Uploader) -> None:
        while True:
            await own.send(FILE)
            sent.append(time.monotonic())

    async with running_console(cell, cell.folder, free_port()) as console:
        own = await uploader(console)
        tasks = [asyncio.create_task(send(own)) for _ in range(UPLOADS)]
        try:
            yield lambda: len(sent) / (sent[-1] - sent[0]) if len(sent) > 1 else 0.0
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


async def _measure(cell: RunningCell, name: str, stops: int, found: Found) -> None:
    presses: dict[str, Callable[[], Awaitable[object]]] = {"udp:": cell.planner.stop, "bus:": cell.client.stop}
    begun = {route: asyncio.Event() for route in presses}

    def see(event: DeviceEvent) -> None:
        route = event.device[:4]
        if event.code == "stopped" and route in begun and FLOODER not in event.device:
            begun[route].set()

    end = cell.client.listen("state/event", DeviceEvent, see)
    try:
        async with timer_lateness() as timer:
            for _ in range(stops):
                for route, press in presses.items():
                    begun[route] = asyncio.Event()
                    what = AT_THE_SOCKET if (name, route) == ("udp", "udp:") else f"{DURING}{name}"
                    await _press(press, begun[route], what, route, found)
        found.times[f"{TIMER}{name}"] += timer.late
    finally:
        await end()


async def _press(
    press: Callable[[], Awaitable[object]], begun: asyncio.Event, what: str, route: str, found: Found
) -> None:
    pressed_at = time.monotonic()
    pressing = asyncio.ensure_future(press())
    seen = asyncio.create_task(begun.wait())
    done, _ = await asyncio.wait([seen, pressing], timeout=PATIENCE, return_when=asyncio.FIRST_COMPLETED)
    if seen in done or (pressing in done and pressing.exception() is None):
        found.times[what].append(time.monotonic() - pressed_at)
    else:
        found.wrong.append(f"{what}: a Stop by {route} did not begin within {PATIENCE:g} s.")
    seen.cancel()
    try:
        await pressing
    except PcmrsError as error:
        found.notes[f"{what}, {route} {error.code}"] += 1
    found.pressed[f"{what} {route}"] += 1
    await asyncio.sleep(APART)
