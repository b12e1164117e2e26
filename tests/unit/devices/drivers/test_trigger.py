"""The driver of a stimulator behind a trigger: its markers, its serial port, and its configuration."""

from __future__ import annotations

import asyncio
import os
import pty
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from typing import Any

import pytest

from pcmrs.devices.drivers.trigger import TriggerStimulator, open_devices
from pcmrs.devices.lsl.inlet import Inlet
from pcmrs.devices.lsl.library import load_lsl
from pcmrs.devices.lsl.markers import PulseMarker, read_pulse
from pcmrs.errors import ConfigurationError, DeviceError, UnknownOutcomeError
from pcmrs.testing.clock import ManualClock, settle
from tests.unit.devices.contract_stimulators import next_event
from tests.unit.devices.lsl_lab import PATIENCE, own
from tests.unit.devices.serial_port import Port


@pytest.fixture(autouse=True)
def _outlets_live_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until this process ends: liblsl 1.18 crashes now and then when one is destroyed that somebody reads."""
    monkeypatch.setattr(load_lsl().StreamOutlet, "__del__", lambda _: None)


@asynccontextmanager
async def stimulator(clock: ManualClock, **table: Any) -> AsyncIterator[TriggerStimulator]:
    table = {"markers": own("pulses"), "dialled": True} | table
    async with open_devices(("stimulator",), {"trigger": table}, clock) as devices:
        yield devices["stimulator"]


async def heard(inlet: Inlet, count: int) -> list[tuple[PulseMarker | None, float]]:
    found: list[tuple[PulseMarker | None, float]] = []
    async with asyncio.timeout(PATIENCE):
        while len(found) < count:
            texts, times = inlet.pull()
            found += [(read_pulse(text[0]), float(time)) for text, time in zip(texts, times, strict=True)]
            await asyncio.sleep(0.01)
    return found


async def test_a_pulse_is_marked_when_it_is_given() -> None:
    name = own("pulses")
    with closing(Inlet(name)) as inlet:
        async with stimulator(ManualClock(), markers=name) as device:
            await device.set_intensity(55.0)
            await device.arm()
            async with asyncio.timeout(PATIENCE):
                while inlet.problem:
                    inlet.pull()
                    await asyncio.sleep(0.01)
            before = load_lsl().local_clock()
            await device.fire(7)
            after = load_lsl().local_clock()
            ((marker, time),) = await heard(inlet, 1)
    assert marker == PulseMarker(7, 55.0)
    assert before - 1e-3 < time < after + 1e-3  # of the estimate of the clocks' offset


async def test_intensity_is_accepted_only_if_it_is_dialled() -> None:
    async with stimulator(ManualClock(), dialled=False) as device:
        with pytest.raises(DeviceError, match=r"trigger\.dialled = true"):
            await device.set_intensity(40.0)
        state = await device.state()
        assert (state.intensity, state.coil_temperature) == (None, None)


@pytest.fixture
def line() -> Any:
    controller, port = pty.openpty()
    tty.setraw(port)
    os.set_blocking(controller, False)
    yield controller, os.ttyname(port)
    for each in (controller, port):
        try:
            os.close(each)
        except OSError:
            continue


async def test_a_pulse_is_one_byte_on_the_port(line: tuple[int, str]) -> None:
    controller, port = line
    async with stimulator(ManualClock(), port=port, byte=0xA5) as device:
        await device.arm()
        async with asyncio.timeout(PATIENCE):
            await device.fire(1)
        assert os.read(controller, 16) == b"\xa5"
        with pytest.raises(DeviceError, match="given already"):
            await device.fire(1)
        await device.disarm()
        with pytest.raises(DeviceError, match="not armed"):
            await device.fire(2)
        with pytest.raises(BlockingIOError):
            os.read(controller, 16)


async def test_absent_port_is_an_error_on_arming() -> None:
    async with stimulator(ManualClock(), port="/dev/no-such-port") as device:
        with pytest.raises(DeviceError, match="/dev/no-such-port cannot be opened"):
            await device.arm()
        assert not (await device.state()).armed


async def test_failed_port_leaves_the_outcome_unknown_and_disarms() -> None:
    clock = ManualClock()
    async with stimulator(clock, port="/dev/no-such-port") as device:
        port = Port()
        assert device._line is not None
        device._line._serial = port
        event = asyncio.create_task(next_event(device))
        await settle()
        await device.arm()
        port.broken = True
        with pytest.raises(UnknownOutcomeError, match="counter"):
            async with asyncio.timeout(PATIENCE):
                await device.fire(1)
        assert (await event).code == "disarmed"
        state = await device.state()
        assert (state.armed, state.pulse) == (False, 1)
        port.broken, port.is_open = False, True
        await device.arm()
        with pytest.raises(DeviceError, match="given already"):
            await device.fire(1)


@pytest.mark.parametrize(
    ("devices", "table", "text"),
    [
        (("emg",), {}, "serves stimulator only"),
        (("stimulator",), {"byte": 256}, "byte"),
        (("stimulator",), {"signal": "cts"}, "signal"),
        (("stimulator",), {"width": 1.0}, "width"),
    ],
)
async def test_bad_configuration_is_refused(devices: tuple[str, ...], table: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigurationError, match=text):
        async with open_devices(devices, {"trigger": table}, ManualClock()):
            pass
