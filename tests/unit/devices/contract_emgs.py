"""Every driver of an electromyograph, with a subject who is stimulated at the hot-spot."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass

from pcmrs.devices.drivers.lsl import LslSettings
from pcmrs.devices.lsl.markers import PulseMarker
from pcmrs.devices.protocols import Emg
from pcmrs_sim.emg import SimEmg
from pcmrs_sim.lsl.emg_bench import EmgBench
from pcmrs_sim.lsl.streams import EmgOutlet, PulseInlet
from pcmrs_sim.muscle.muscle import Muscle
from pcmrs_sim.settings import MuscleSettings
from tests.unit.devices.lsl_lab import CLOCK, KEPT, first_epoch, lsl_emg, marker_outlet, own, running

QUIET = MuscleSettings(noise_uv=1.0, hum_uv=1.0, artefact_mv=20.0, artefact_decay=0.0004, full_scale_mv=50.0)


@dataclass
class Lab:
    """An electromyograph on a subject.

    Attributes:
        fire: Gives the pulse of a number with an intensity, percent.
        threshold: Of the subject, percent.
    """

    emg: Emg
    muscle: Muscle
    fire: Callable[[int, float], object]
    threshold: float


class _World:
    """As much of the simulated world as its electromyograph looks at."""

    def __init__(self, bench: EmgBench) -> None:
        self.settings = type("Settings", (), {"muscle": QUIET})
        self.muscle = bench.muscle


@asynccontextmanager
async def simulated() -> AsyncIterator[Lab]:
    bench = EmgBench(QUIET, 3, CLOCK)
    emg = SimEmg(_World(bench), CLOCK)  # type: ignore[arg-type]

    def fire(number: int, intensity: float) -> None:
        bench.stimulate(number, intensity, CLOCK.monotonic())

    yield Lab(emg, bench.muscle, fire, float(bench.subject.recruitment.threshold))


@asynccontextmanager
async def streamed() -> AsyncIterator[Lab]:
    bench = EmgBench(QUIET, 3, CLOCK)
    settings = LslSettings(stream=own("emg"), markers=own("pulses"), full_scale=50e-3)
    async with AsyncExitStack() as stack:
        markers = marker_outlet(settings.markers)
        outlet = EmgOutlet(settings.stream, QUIET.rate_hz, bench.muscle.samples, CLOCK)
        KEPT.append(outlet)
        await stack.enter_async_context(running(outlet))
        await stack.enter_async_context(running(PulseInlet(settings.markers, bench.stimulate, CLOCK)))
        emg = await stack.enter_async_context(lsl_emg(settings))
        await first_epoch(emg, markers)

        def fire(number: int, intensity: float) -> None:
            markers.push(PulseMarker(number, intensity).text)

        yield Lab(emg, bench.muscle, fire, float(bench.subject.recruitment.threshold))


EMGS: dict[str, Callable[[], AbstractAsyncContextManager[Lab]]] = {"sim": simulated, "lsl": streamed}
"""By driver."""
