"""The simulated cell on Lab Streaming Layer, for drivers of real devices on the same machine."""

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
    """Serve the muscle of a cell as the drivers of stimulator and electromyograph need it.

    With ``emg.driver = "lsl"``, its electromyogram is streamed, and a simulated stimulator sends a marker per pulse.
    With ``stimulator.driver = "trigger"``, the markers of that stimulator stimulate it.

    Args:
        cell: The running cell.
        settings: The whole configuration.

    Raises:
        ConfigurationError: Lab Streaming Layer is needed and not installed.
    """
    stimulator, emg = (settings.get(device, {}).get("driver") for device in ("stimulator", "emg"))
    lsl, world = settings.get("lsl", {}), cell.world
    streams = []
    if stimulator == "trigger":
        markers = settings.get("trigger", {}).get("markers", PULSES)
        streams.append(PulseInlet(markers, world.stimulate, cell.clock).run())
    if emg == "lsl" and world.settings.muscle.streamed:
        stream = lsl.get("stream", EMG)
        outlet = EmgOutlet(stream, world.settings.muscle.rate_hz, lambda *of: world.muscle.samples(*of), cell.clock)
        streams.append(outlet.run())
        log.info("virtual_muscle_streamed", stream=stream)
        if stimulator == "sim":
            world.pulse_listeners.append(_marker(lsl.get("markers", PULSES), cell))
    async with AsyncExitStack() as stack:
        for stream in streams:
            await stack.enter_async_context(background_task(stream))
        yield


def _marker(name: str, cell: CellSimulation) -> Any:
    """Return a function that sends a marker for each pulse of the simulated stimulator, on a stream of a name."""
    outlet, offset = MarkerOutlet(name), lsl_minus(cell.clock)

    def mark(number: int, intensity: float, time: float) -> None:
        outlet.push(PulseMarker(number, intensity).text, time + offset)

    return mark
