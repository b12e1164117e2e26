""""""

import asyncio
from collections.abc import AsyncIterator

import numpy as np
import pytest

from pcmrs.devices.drivers.lsl import LslEmg, LslSettings, open_devices
from pcmrs.devices.lsl.library import load_lsl
from pcmrs.devices.lsl.markers import MarkerOutlet, PulseMarker
from pcmrs.errors import ConfigurationError, DeviceError
from pcmrs.spatial import Floats
from tests.unit.devices.lsl_lab import (
    CLOCK,
    PATIENCE,
    RATE,
    Amplifier,
    first_epoch,
    lsl_emg,
    marker_outlet,
    own,
    process_of,
    running,
)

RAMP_UV_PER_S = 1e4


def ramp(times: Floats) -> Floats:
    """A sawtooth of a second whose value tells the time."""
    return RAMP_UV_PER_S * (times % 1.0)


async def refused_for(emg: LslEmg, markers: MarkerOutlet, why: str) -> None:
    """Returns once an epoch is refused for that reason, whatever the reasons before."""
    async with asyncio.timeout(PATIENCE):
        number, text = 1000, ""
        while why not in text:
            number += 1
            markers.push(PulseMarker(number).text)
            try:
                await emg.epoch(number, 0.01, 0.01)
            except DeviceError as error:
                text = error.text


@pytest.fixture
def settings() -> LslSettings:
    return LslSettings(stream=own("emg"), markers=own("pulses"), channel=1, full_scale=5e-3)


@pytest.fixture
async def emg(settings: LslSettings) -> AsyncIterator[LslEmg]:
    async with lsl_emg(settings) as emg:
        yield emg


async def test_an_epoch_lies_around_its_pulse(emg: LslEmg, settings: LslSettings) -> None:
    markers = marker_outlet(settings.markers)
    async with running(Amplifier(settings.stream, ramp)):
        await first_epoch(emg, markers)
        given = load_lsl().local_clock()
        markers.push(PulseMarker(70, 55.0).text, given)
        epoch = await emg.epoch(70, 0.05, 0.1)
    assert (epoch.pulse, epoch.muscle, epoch.rate_hz, epoch.full_scale) == (70, "FDI", RATE, 5e-3)
    assert len(epoch.samples) == pytest.approx(0.15 * RATE, abs=1)
    times = given + epoch.start + np.arange(len(epoch.samples)) / RATE
    late = (np.array(epoch.samples) * 1e6 - ramp(times)) / RAMP_UV_PER_S
    assert np.abs(late[np.abs(late) < 0.5]).max() < 2 / RATE  # the sawtooth may jump at one sample
    assert -0.05 <= epoch.start < -0.05 + 2 / RATE


async def test_pulse_without_a_marker_has_no_epoch(emg: LslEmg, settings: LslSettings) -> None:
    async with running(Amplifier(settings.stream, ramp)):
        with pytest.raises(DeviceError, match=f"stream '{settings.markers}' has not been found"):
            await emg.epoch(1, 0.05, 0.05)
        markers = marker_outlet(settings.markers)
        await first_epoch(emg, markers)
        markers.push("state:0->1")
        with pytest.raises(DeviceError, match="Pulse 99 has no epoch: no marker"):
            await emg.epoch(99, 0.05, 0.05)


async def test_a_silent_amplifier_is_named(emg: LslEmg, settings: LslSettings) -> None:
    markers = marker_outlet(settings.markers)
    async with running(Amplifier(settings.stream, ramp)):
        await first_epoch(emg, markers)
    markers.push(PulseMarker(50).text)
    with pytest.raises(DeviceError, match="sends nothing"):
        await emg.epoch(50, 0.05, 0.05)


async def test_an_amplifier_that_ends_is_named_and_found_again(emg: LslEmg, settings: LslSettings) -> None:
    markers = marker_outlet(settings.markers)
    async with process_of("emg", settings.stream):
        await first_epoch(emg, markers)
    await refused_for(emg, markers, "start its source again")
    async with running(Amplifier(settings.stream, ramp)):
        assert (await first_epoch(emg, markers)).samples


async def test_a_source_of_markers_that_ends_is_found_again(emg: LslEmg, settings: LslSettings) -> None:
    async with running(Amplifier(settings.stream, ramp)):
        async with process_of("markers", settings.markers), asyncio.timeout(PATIENCE):
            while not emg._pulses:  # noqa: ASYNC110 - nobody tells of them
                await asyncio.sleep(0.01)
        await first_epoch(emg, marker_outlet(settings.markers))


async def test_lost_samples_are_not_passed_over(emg: LslEmg, settings: LslSettings) -> None:
    markers = marker_outlet(settings.markers)
    async with running(Amplifier(settings.stream, ramp)) as amplifier:
        await first_epoch(emg, markers)
        markers.push(PulseMarker(60).text)
        amplifier.lost = 40
        with pytest.raises(DeviceError, match="Samples of the epoch are missing"):
            await emg.epoch(60, 0.05, 0.1)


async def test_two_streams_of_one_name_are_refused(emg: LslEmg, settings: LslSettings) -> None:
    markers = marker_outlet(settings.markers)
    async with running(Amplifier(settings.stream, ramp)):
        await first_epoch(emg, markers)
        async with process_of("emg", settings.stream):
            await refused_for(emg, markers, "exists 2 times")
        await first_epoch(emg, markers)


@pytest.mark.parametrize(("channel", "rate", "text"), [(5, RATE, "2 channels"), (1, 0.0, "no numbers at a fixed rate")])
async def test_an_unusable_stream_says_why(channel: int, rate: float, text: str) -> None:
    settings = LslSettings(stream=own("emg"), markers=own("pulses"), channel=channel)
    async with lsl_emg(settings) as emg, running(Amplifier(settings.stream, ramp, rate)):
        await refused_for(emg, marker_outlet(settings.markers), text)


@pytest.mark.parametrize(("before", "after"), [(-0.1, 0.1), (0.1, -0.1), (100.0, 0.1), (float("nan"), 0.1)])
async def test_an_impossible_window_is_refused(emg: LslEmg, before: float, after: float) -> None:
    with pytest.raises(DeviceError, match="range of both is 0 to 5 s"):
        await emg.epoch(1, before, after)


@pytest.mark.parametrize(
    ("devices", "table", "text"),
    [
        (("robot",), {}, "serves emg only"),
        (("emg",), {"stream": "a' or '1'='1"}, "stream"),
        (("emg",), {"jitter": 0.0}, "jitter"),
        (("emg",), {"chanel": 1}, "chanel"),
    ],
)
async def test_bad_configuration_is_refused(devices: tuple[str, ...], table: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigurationError, match=text):
        async with open_devices(devices, {"lsl": table}, CLOCK):
            pass
