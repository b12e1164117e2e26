"""`pcmrs-sim muscle` as a process: a subject that answers and takes orders."""

import asyncio
import json
import signal
import sys
from asyncio.subprocess import PIPE

import pytest

from pcmrs.devices.drivers import lsl, trigger
from pcmrs.devices.lsl.library import load_lsl
from tests.unit.sim.lsl.muscle_streams import CLOCK, configuration, first_answer, response_of

COMMAND = "from pcmrs_sim.cli.muscle import muscle; muscle()"


@pytest.fixture(autouse=True)
def _outlets_live_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until this process ends: liblsl 1.18 crashes now and then when one is destroyed that somebody reads."""
    monkeypatch.setattr(load_lsl().StreamOutlet, "__del__", lambda _: None)


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
