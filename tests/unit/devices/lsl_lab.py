"""Streams of a lab for the tests: an amplifier and a source of markers of the real library, with their own names."""

import asyncio
import sys
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from typing import Any, Protocol, TypeVar
from uuid import uuid4

import msgspec
import numpy as np

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers.lsl import LslEmg, LslSettings, open_devices
from pcmrs.devices.lsl.library import load_lsl
from pcmrs.devices.lsl.markers import MarkerOutlet, PulseMarker
from pcmrs.errors import DeviceError
from pcmrs.messages import Epoch
from pcmrs.spatial import Floats

RATE = 5000
CLOCK = SystemClock()
PATIENCE = 10.0  # s; what is waited for takes a second on a machine that has time


KEPT: list[object] = []
"""Outlets, until this process ends: liblsl 1.18 crashes now and then when one is destroyed that somebody reads."""


def marker_outlet(name: str) -> MarkerOutlet:
    KEPT.append(outlet := MarkerOutlet(name))
    return outlet


def own(name: str) -> str:
    """A name that no other test on this machine uses."""
    return f"{name}-{uuid4().hex}"


class Runs(Protocol):
    def run(self) -> Coroutine[Any, Any, None]: ...


R = TypeVar("R", bound=Runs)


class Amplifier:
    """Sends a signal of two channels: zero, and the second a function of the library's time, in uV."""

    def __init__(self, name: str, signal: Callable[[Floats], Floats], rate: float = RATE) -> None:
        self._lsl = load_lsl()
        info = self._lsl.StreamInfo(name, "EMG", 2, rate, self._lsl.cf_float32, own("amplifier"))
        self._outlet = self._lsl.StreamOutlet(info)
        KEPT.append(self._outlet)
        self._signal = signal
        self._next = int(self._lsl.local_clock() * RATE)
        self.lost = 0

    async def run(self) -> None:
        while True:
            await asyncio.sleep(0.01)
            due = int(self._lsl.local_clock() * RATE)
            times = np.arange(self._next + self.lost, due) / RATE
            self.lost = 0
            if times.size:
                samples = np.stack([np.zeros_like(times), self._signal(times)], axis=1).astype(np.float32)
                self._outlet.push_chunk(samples, float(times[-1]))
            self._next = due


@asynccontextmanager
async def running(source: R) -> AsyncIterator[R]:
    task = asyncio.create_task(source.run())
    try:
        yield source
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


@asynccontextmanager
async def process_of(kind: str, name: str) -> AsyncIterator[None]:
    """An amplifier (``emg``) or an idle source of markers (``markers``) in a process that is killed in the end."""
    process = await asyncio.create_subprocess_exec(sys.executable, __file__, kind, name)
    try:
        yield
    finally:
        process.kill()
        await process.wait()


@asynccontextmanager
async def lsl_emg(settings: LslSettings) -> AsyncIterator[LslEmg]:
    async with open_devices(("emg",), {"lsl": msgspec.to_builtins(settings)}, CLOCK) as devices:
        yield devices["emg"]


async def first_epoch(emg: LslEmg, markers: MarkerOutlet, before: float = 0.05, after: float = 0.05) -> Epoch:
    """The epoch of the first pulse that is seen: those before streams are connected are lost, as in a lab."""
    number = 0
    async with asyncio.timeout(PATIENCE):
        while True:
            number += 1
            markers.push(PulseMarker(number, 50.0).text)
            try:
                return await emg.epoch(number, before, after)
            except DeviceError:
                continue


async def _main(kind: str, name: str) -> None:
    if kind == "emg":
        await Amplifier(name, np.zeros_like).run()
    outlet = marker_outlet(name)
    number = 1_000_000
    while True:
        await asyncio.sleep(0.05)
        number += 1
        outlet.push(PulseMarker(number).text)


if __name__ == "__main__":
    asyncio.run(_main(*sys.argv[1:]))
