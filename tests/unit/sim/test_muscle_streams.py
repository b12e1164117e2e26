"""The virtual muscle on real streams: beside the drivers of real devices, and as a process of its own."""

import asyncio
import json
import signal
import sys
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from typing import Any
from uuid import uuid4

import numpy as np
import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers import lsl, trigger
from pcmrs.devices.lsl.library import load_lsl
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.protocols import Emg, Stimulator
from pcmrs.errors import DeviceError
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import Epoch
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.lsl.serving import serve_muscle
from pcmrs_sim.muscle.head_subject import draw_subject
from pcmrs_sim.settings import MuscleSettings, SimSettings, StimulatorSettings

CLOCK = SystemClock()
PATIENCE = 10.0  # s
COMMAND = "from pcmrs_sim.cli.muscle import muscle; muscle()"


@pytest.fixture(autouse=True)
def _outlets_live_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until this process ends: liblsl 1.18 crashes now and then when one is destroyed that somebody reads."""
    monkeypatch.setattr(load_lsl().StreamOutlet, "__del__", lambda _: None)


def make_cell() -> CellSimulation:
    """A cell that stands still: only its muscle is needed."""
    stimulator = StimulatorSettings(charge_time=0.0, recharge_time=0.0)
    return CellSimulation(SimSettings(seed=3, stimulator=stimulator), ARMS["iiwa14"], ForceSettings(), CLOCK)


def configuration(stimulator: str, emg: str) -> dict[str, Any]:
    name = uuid4().hex
    return {
        "stimulator": {"driver": stimulator},
        "emg": {"driver": emg},
        "trigger": {"markers": f"pulses-{name}", "dialled": True},
        "lsl": {"stream": f"emg-{name}", "markers": f"pulses-{name}"},
    }


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


async def first_answer(stimulator: Stimulator, emg: Emg) -> Epoch:
    """Fires until all streams are connected and the muscle answers; what was sent before is lost, as in a lab."""
    number = 0
    async with asyncio.timeout(PATIENCE):
        while True:
            number += 1
            await stimulator.fire(number)
            with suppress(DeviceError):
                epoch = await emg.epoch(number, 0.05, 0.06)
                if response_of(epoch) > 100e-6:
                    return epoch


@pytest.mark.parametrize(("stimulator", "emg"), [("trigger", "lsl"), ("sim", "lsl"), ("trigger", "sim")])
async def test_one_muscle_answers_whatever_drives_it(stimulator: str, emg: str) -> None:
    cell, settings = make_cell(), configuration(stimulator, emg)
    subject = draw_subject("head", 3)
    assert subject is not None
    coil = cell.world.tracker_from_image @ subject.image_from_hotspot
    cell.world.tracker_from_coil = lambda: coil  # type: ignore[method-assign]
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


async def test_command_streams_a_subject_that_answers_and_takes_orders() -> None:
    settings = configuration("trigger", "lsl")
    names = "--stream", settings["lsl"]["stream"], "--markers", settings["lsl"]["markers"]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", COMMAND, "--seed", "3", "--json", *names, stdin=PIPE, stdout=PIPE, stderr=PIPE
    )
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    said = json.loads(await process.stdout.readline())
    assert (said["stream"], said["seed"]) == (settings["lsl"]["stream"], 3)
    async with (
        trigger.open_devices(("stimulator",), settings, CLOCK) as triggered,
        lsl.open_devices(("emg",), settings, CLOCK) as streamed,
    ):
        stimulator, emg = triggered["stimulator"], streamed["emg"]
        await stimulator.set_intensity(100.0)
        await stimulator.arm()
        answered = await first_answer(stimulator, emg)
        process.stdin.write(b"coil 500 0 0 0\nnonsense\n")
        assert b"'nonsense' is not understood" in await process.stderr.readline()
        await stimulator.fire(answered.pulse + 1)
        assert response_of(await emg.epoch(answered.pulse + 1, 0.05, 0.06)) < 50e-6
    process.send_signal(signal.SIGTERM)
    assert await process.wait() == 0


def response_of(epoch: Epoch) -> float:
    times = epoch.start + np.arange(len(epoch.samples)) / epoch.rate_hz
    return float(np.ptp(np.array(epoch.samples)[(times > 0.015) & (times < 0.05)]))
