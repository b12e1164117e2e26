"""The simulated electromyograph, as a device of the cell."""

from __future__ import annotations

import math

from pcmrs.clock import Clock
from pcmrs.devices.lsl.epochs import check_window
from pcmrs.errors import DeviceError
from pcmrs.messages import Epoch
from pcmrs_sim.muscle.muscle import Stimulus
from pcmrs_sim.world import World

MUSCLE = "FDI"
"""First dorsal interosseous of the hand opposite the stimulated hemisphere."""
GRACE = 0.5
"""Time after the last sample of an epoch for which its pulse is awaited, s of the clock."""
POLL_PERIOD = 0.01
"""Period of polls for a pulse that was not given yet, s of the clock."""


class SimEmg:
    """Implementation of `pcmrs.devices.protocols.Emg` on the muscle of a world.

    Args:
        world: World with the muscle.
        clock: The cell's clock.
    """

    def __init__(self, world: World, clock: Clock) -> None:
        self._world = world
        self._clock = clock

    async def epoch(self, pulse: int, before: float, after: float) -> Epoch:
        check_window(before, after)
        stimulus = await self._stimulus(pulse, self._clock.monotonic() + after + GRACE)
        await self._clock.sleep(stimulus.time + after - self._clock.monotonic())
        settings = self._world.settings.muscle
        first = math.ceil((stimulus.time - before) * settings.rate_hz)
        last = math.floor((stimulus.time + after) * settings.rate_hz)
        return Epoch(
            pulse=pulse,
            muscle=MUSCLE,
            rate_hz=float(settings.rate_hz),
            start=first / settings.rate_hz - stimulus.time,
            samples=self._world.muscle.samples(first, last - first + 1).tolist(),
            full_scale=settings.full_scale_mv * 1e-3,
        )

    async def _stimulus(self, pulse: int, deadline: float) -> Stimulus:
        while (stimulus := self._world.muscle.stimulus(pulse)) is None:
            if self._clock.monotonic() >= deadline:
                raise DeviceError(f"Pulse {pulse} has no epoch: the stimulator did not give it.", pulse=pulse)
            await self._clock.sleep(POLL_PERIOD)
        return stimulus
