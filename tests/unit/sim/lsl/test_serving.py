"""The simulated muscle on real streams, beside the drivers of real devices."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import pytest

from pcmrs.devices.drivers import lsl, trigger
from pcmrs.devices.lsl.library import load_lsl
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ARMS
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.lsl.serving import serve_muscle
from pcmrs_sim.muscle.head_subject import draw_subject
from pcmrs_sim.settings import MuscleSettings, SimSettings, StimulatorSettings
from tests.unit.sim.lsl.muscle_streams import CLOCK, configuration, first_answer, response_of


@pytest.fixture(autouse=True)
def _outlets_live_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until this process ends: liblsl 1.18 crashes now and then when one is destroyed that somebody reads."""
    monkeypatch.setattr(load_lsl().StreamOutlet, "__del__", lambda _: None)


def make_cell() -> CellSimulation:
    """A cell that stands still: only its muscle is needed."""
    stimulator = StimulatorSettings(charge_time=0.0, recharge_time=0.0)
    return CellSimulation(SimSettings(seed=3, stimulator=stimulator), ARMS["iiwa14"], ForceSettings(), CLOCK)


@asynccontextmanager
async def devices(cell: CellSimulation, settings: dict[str, Any]) -> AsyncIterator[tuple[Any, Any]]:
    """Stimulator and electromyograph as they are configured, beside the cell."""
    found = {"stimulator": cell.devices["stimulator"], "emg": cell.devices["emg"]}
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(serve_muscle(cell, settings))
        for name, driver in (("stimulator", trigger), ("emg", lsl)):
            if settings[name]["driver"] != "sim":
                found.update(await stack.enter_async_context(driver.open_devices((name,), settings, CLOCK)))
        yield found["stimulator"], found["emg"]


@pytest.mark.parametrize(("stimulator", "emg"), [("trigger", "lsl"), ("sim", "lsl"), ("trigger", "sim")])
async def test_one_muscle_answers_whatever_drives_it(stimulator: str, emg: str) -> None:
    cell, settings = make_cell(), configuration(stimulator, emg)
    subject = draw_subject("head", 3)
    assert subject is not None
    coil = cell.world.tracker_from_image @ subject.image_from_hotspot
    cell.world.tracker_from_tool_tip = lambda: coil  # type: ignore[method-assign]
    async with devices(cell, settings) as (stimulating, measuring):
        await stimulating.set_intensity(100.0)
        await stimulating.arm()
        epoch = await first_answer(stimulating, measuring)
    felt = cell.world.muscle.stimulus(epoch.pulse)
    assert felt is not None
    assert (felt.intensity, epoch.muscle) == (100.0, "FDI")
    assert response_of(epoch) == pytest.approx(felt.amplitude, abs=30e-6)


async def test_simulated_or_real_amplifier_gets_no_simulated_stream() -> None:
    before = asyncio.all_tasks()
    silent = CellSimulation(SimSettings(muscle=MuscleSettings(streamed=False)), ARMS["iiwa14"], ForceSettings(), CLOCK)
    for cell, settings in ((make_cell(), configuration("sim", "sim")), (silent, configuration("sim", "lsl"))):
        async with serve_muscle(cell, settings):
            assert asyncio.all_tasks() == before
            assert not cell.world.pulse_listeners
