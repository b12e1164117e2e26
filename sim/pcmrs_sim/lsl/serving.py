"""What the simulated cell does on Lab Streaming Layer for drivers of real devices on the same machine."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import structlog

from pcmrs.background import background_task
from pcmrs.devices.lsl.library import EMG
from pcmrs.devices.lsl.markers import PULSES, MarkerOutlet, PulseMarker
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.lsl.streams import EmgOutlet, PulseInlet, lsl_minus

log = structlog.get_logger(__name__)


@asynccontextmanager
async def serve_muscle(cell: CellSimulation, settings: Mapping[str, Any]) -> AsyncIterator[None]:
    """Serves the muscle of the cell's world as the drivers of stimulator and electromyograph need it.

    With ``emg.driver = "lsl"`` its electromyogram is streamed, and the pulses of a simulated stimulator are marked;
    with ``stimulator.driver = "trigger"`` the markers of that stimulator stimulate it.

    Args:
        cell: The one world that all devices share.
        settings: The whole configuration.

    Raises:
        ConfigurationError: Lab Streaming Layer is needed and not installed.
    """
    stimulator, emg = (settings.get(device, {}).get("driver") for device in ("stimulator", "emg"))
    lsl, world = settings.get("lsl", {}), cell.world
    works = []
    if stimulator == "trigger":
        markers = settings.get("trigger", {}).get("markers", PULSES)
        works.append(PulseInlet(markers, world.stimulate, cell.clock).run())
    if emg == "lsl" and world.settings.muscle.streamed:
        stream = lsl.get("stream", EMG)
        outlet = EmgOutlet(stream, world.settings.muscle.rate_hz, lambda *of: world.muscle.samples(*of), cell.clock)
        works.append(outlet.run())
        log.info("virtual_muscle_streamed", stream=stream)
        if stimulator == "sim":
            world.pulse_listeners.append(_marking(lsl.get("markers", PULSES), cell))
    async with AsyncExitStack() as stack:
        for work in works:
            await stack.enter_async_context(background_task(work))
        yield


def _marking(name: str, cell: CellSimulation) -> Any:
    """What marks a pulse of the simulated stimulator on a stream of that name."""
    outlet, offset = MarkerOutlet(name), lsl_minus(cell.clock)

    def mark(number: int, intensity: float, time: float) -> None:
        outlet.push(PulseMarker(number, intensity).text, time + offset)

    return mark
