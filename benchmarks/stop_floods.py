"""Stop while the bus is flooded: the time until it has begun, for a press by UDP and one over the bus.

Each kind of flood has a separate daemon, on the simulated cell at real time, and one process that floods as one user
without the lease. The daemon of the first kind is measured without a flood before. The time of a press is from the call
to the event that names its source, as this process receives it, or to its answer, if that is earlier: the latch is set
and the holds are sent before. If many users press, several presses are reported as one, and only the answer remains.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from contextlib import AsyncExitStack
from pathlib import Path

from stop_found import DURING, TIMER, Found

from pcmrs.errors import PcmrsError
from pcmrs.messages import DeviceEvent
from pcmrs.testing.cell import REAL_TIME, RunningCell, open_cell
from pcmrs.testing.driving import register
from pcmrs_lab.campaign.bus_flood import FLOODER, Kind, bus_flood
from pcmrs_lab.campaign.lateness import timer_lateness

NO_FLOOD = "no flood"
APART = 0.05
"""Time between a Stop that has begun and the next press, s."""
PATIENCE = 5.0


async def flooded(stops: int, kinds: Sequence[Kind]) -> Found:
    """Press Stop by each route during each kind of flood, and without one.

    Args:
        stops: Number of presses by each route.
        kinds: Kinds of floods, at least one.

    Returns:
        Results.
    """
    found = Found()
    for kind in kinds:
        with tempfile.TemporaryDirectory(prefix="pcmrs-", ignore_cleanup_errors=True) as folder:
            async with open_cell(Path(folder) / "flooded", REAL_TIME) as cell:
                await register(cell.client)
                if kind == kinds[0]:
                    await _flooded_by(cell, None, stops, found)
                await _flooded_by(cell, kind, stops, found)
    return found


async def _flooded_by(cell: RunningCell, kind: Kind | None, stops: int, found: Found) -> None:
    name = kind or NO_FLOOD
    presses: dict[str, Callable[[], Awaitable[object]]] = {"udp:": cell.planner.stop, "bus:": cell.client.stop}
    begun = {route: asyncio.Event() for route in presses}

    def see(event: DeviceEvent) -> None:
        route = event.device[:4]
        if event.code == "stopped" and route in begun and FLOODER not in event.device:
            begun[route].set()

    async with AsyncExitStack() as stack:
        stack.push_async_callback(cell.client.listen("state/event", DeviceEvent, see))
        flood = await stack.enter_async_context(bus_flood(kind, cell.ready.endpoint, cell.name)) if kind else None
        timer = await stack.enter_async_context(timer_lateness())
        for _ in range(stops):
            for route, press in presses.items():
                begun[route] = asyncio.Event()
                await _press(press, begun[route], f"{DURING}{name}", route, found)
        found.times[f"{TIMER}{name}"] += timer.late
    if flood is not None:
        found.notes[f"messages per second of {name}"] = round(flood.report.rate)


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
