"""Every driver of a stimulator, as the contract tests need it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from typing import Any

from pcmrs.devices.drivers import trigger
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.protocols import StimulatorDriver
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import DeviceEvent
from pcmrs.testing.clock import ManualClock
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.settings import SimSettings
from tests.unit.devices.lsl_lab import own


@dataclass
class Bench:
    """A stimulator and the clock that it lives by.

    Attributes:
        arm: Arms it, and lets the time pass that this takes.
        wait: Lets time pass, s.
    """

    stimulator: StimulatorDriver
    clock: ManualClock
    wait: Callable[[float], Awaitable[None]]


@asynccontextmanager
async def simulated() -> AsyncIterator[Bench]:
    clock = ManualClock()
    cell = CellSimulation(SimSettings(), ARMS["iiwa14"], ForceSettings(), clock)
    stimulator: Any = cell.devices["stimulator"]

    async def wait(seconds: float) -> None:
        await clock.advance(seconds)
        stimulator.update(clock.monotonic())

    yield Bench(stimulator, clock, wait)
    stimulator.close()


@asynccontextmanager
async def triggered() -> AsyncIterator[Bench]:
    clock = ManualClock()
    table = {"markers": own("pulses"), "dialled": True}
    async with trigger.open_devices(("stimulator",), {"trigger": table}, clock) as devices:
        yield Bench(devices["stimulator"], clock, clock.advance)


async def next_event(stimulator: StimulatorDriver) -> DeviceEvent:
    return await anext(stimulator.events())


STIMULATORS: dict[str, Callable[[], AbstractAsyncContextManager[Bench]]] = {"sim": simulated, "trigger": triggered}
"""By driver."""
