"""A stimulator and an electromyograph in one process, on a subject whose muscle answers; and a bench with them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pcmrs.clock import Clock
from pcmrs.devices.arming import Arming
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import Epoch, FiredPulse, StimulatorState, Verdict
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench

RATE_HZ = 5000.0
QUICK = {"stimulation": {"intervals": {"least": 1.1}, "hotspot": {"rings": 1, "heading_reach_deg": 0.0}}}
"""Short intervals, and a search of one ring without other headings."""
CHARGING = 0.3
RESPONDING = 300e-6
SILENT = 5e-6


@dataclass
class StandInStimulator:
    """Implements `Stimulator` by the rules that every driver keeps.

    Attributes:
        fired: Number and intensity of each pulse, and when.
        mute: Methods that are carried out and never answered; ``state`` and so on.
        deaf: Methods that are never carried out, nor answered.
        reports: What is reported in place of the intensity that is set.
    """

    clock: Clock
    name: str = "stimulator"
    latched: bool = False
    arming: Arming = field(default_factory=lambda: Arming(1e6))
    intensity: float = 0.0
    coil_temperature: float = 25.0
    ready_at: float = 0.0
    fired: list[tuple[int, float, float]] = field(default_factory=list)
    mute: set[str] = field(default_factory=set)
    deaf: set[str] = field(default_factory=set)
    calls: list[str] = field(default_factory=list)
    reports: float | None = None

    async def state(self) -> StimulatorState:
        await self._hear("state")
        return self._state("state")

    async def set_intensity(self, percent: float) -> StimulatorState:
        await self._hear("set_intensity")
        self.intensity = percent
        return self._state("set_intensity")

    async def arm(self) -> StimulatorState:
        await self._hear("arm")
        self.arming.arm(self.clock.monotonic())
        await self.clock.sleep(CHARGING)
        return self._state("arm")

    async def disarm(self) -> StimulatorState:
        await self._hear("disarm")
        self.arming.disarm()
        return self._state("disarm")

    async def stop(self) -> StimulatorState:
        return await self.disarm()

    async def release_latch(self) -> None:
        await self._hear("release_latch")

    async def fire(self, number: int) -> FiredPulse:
        await self._hear("fire")
        self.arming.check(number)
        now = self.clock.monotonic()
        self.arming.take(number, now)
        self.fired.append((number, self.intensity, now))
        self.ready_at = now + CHARGING
        self._answer("fire")
        return FiredPulse(number=number, intensity=self.reports or self.intensity, fired=now)

    async def _hear(self, method: str) -> None:
        self.calls.append(method)
        await asyncio.sleep(0)
        if method in self.deaf:
            self._answer(method)

    def _answer(self, method: str) -> None:
        if method in self.mute | self.deaf:
            raise UnknownOutcomeError(f"The stimulator has not answered {method}.")

    def _state(self, method: str) -> StimulatorState:
        self._answer(method)
        cool = self.coil_temperature < 40.0
        return StimulatorState(
            armed=self.arming.armed,
            ready=self.arming.armed and cool and self.clock.monotonic() >= self.ready_at,
            intensity=self.intensity if self.reports is None else self.reports,
            coil_temperature=self.coil_temperature,
            pulse=self.arming.pulse,
        )


@dataclass
class StandInEmg:
    """Implements `Emg`: a response of `amplitude` (V, by the pulse's intensity) 25 ms after each pulse, over noise.

    Attributes:
        baseline: Activity before the pulse, V rms.
        artefact: What of the stimulus is left when the window begins, V.
        full_scale: Of the amplifier, V.
        lost: The markers of the pulses are not seen.
    """

    stimulator: StandInStimulator
    clock: Clock
    amplitude: Callable[[float], float] = lambda _: RESPONDING
    baseline: float = 2e-6
    artefact: float = 0.0
    full_scale: float = 5e-3
    lost: bool = False

    async def epoch(self, pulse: int, before: float, after: float) -> Epoch:
        await self.clock.sleep(after)
        if self.lost or pulse not in [number for number, _, _ in self.stimulator.fired]:
            raise DeviceError(f"No marker of pulse {pulse} was seen.", code="no_marker")
        intensity = self.stimulator.fired[-1][1]
        times = np.arange(-before, after, 1.0 / RATE_HZ)
        signal = np.random.default_rng(pulse).normal(0.0, self.baseline, len(times))
        wave = np.where((times > 0.022) & (times < 0.032), np.sin((times - 0.022) * 2.0 * np.pi / 0.010), 0.0)
        signal += 0.5 * self.amplitude(intensity) * wave
        signal[(times > 0.0) & (times < 0.016)] += self.artefact
        held = np.clip(signal, -self.full_scale, self.full_scale)
        return Epoch(
            pulse=pulse,
            muscle="FDI",
            rate_hz=RATE_HZ,
            start=float(times[0]),
            samples=held.tolist(),
            full_scale=self.full_scale,
        )


class StimulationBench:
    """A workflow's bench whose stimulator and electromyograph are stand-ins, at which everything can be set."""

    def __init__(self, bench: WorkflowBench) -> None:
        self.bench = bench
        self.clock = bench.clock
        self.stimulator = StandInStimulator(bench.clock)
        self.emg = StandInEmg(self.stimulator, bench.clock)
        bench.cell.stimulator, bench.cell.emg = self.stimulator, self.emg
        self.accept, self.refuse, self.do = bench.accept, bench.refuse, bench.do

    @property
    def states(self) -> dict[str, str]:
        return self.bench.states

    @property
    def data(self) -> Any:
        return self.bench.data

    async def allow(self, ceiling: float = 70.0, intensity: float = 50.0) -> None:
        """Sets ceiling and intensity."""
        await self.accept("stimulation.set_ceiling", percent=ceiling, operator="Dr Hand")
        await self.accept("stimulation.set_intensity", percent=intensity)

    async def aligned(self) -> None:
        await self.bench.until(lambda: self.states["alignment"] == "1")

    async def to_armed(self) -> None:
        """Placed, aligned and armed, with the interval behind."""
        await self.bench.to_placed()
        await self.allow()
        await self.arm()

    async def arm(self) -> None:
        await self.accept("stimulation.arm")
        await self.aligned()
        await self.rest()

    async def rest(self) -> None:
        """Lets the least interval between pulses pass."""
        await self.clock.sleep(1.2)

    async def until(self, condition: Callable[[], bool]) -> None:
        await self.bench.until(condition)


def result_of(verdict: Verdict) -> dict[str, Any]:
    """Return the result that a verdict must have."""
    assert verdict.result is not None
    return verdict.result


@asynccontextmanager
async def stimulation(
    procedure: Mapping[str, Any] | None = None, sim: Mapping[str, Any] | None = None
) -> AsyncIterator[StimulationBench]:
    """A bench of `ratms_threshold`."""
    values = {"stimulation": QUICK["stimulation"] | (procedure or {}).get("stimulation", {})}
    async with open_bench({**(procedure or {}), **values}, sim, workflow="ratms_threshold") as bench:
        yield StimulationBench(bench)
