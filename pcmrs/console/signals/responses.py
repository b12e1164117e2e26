"""What the charts of the muscle show: responses, signals and hunts as points. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import msgspec
import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.messages import DeviceEvent, Epoch, Verdict
from pcmrs.tms.mep import waveform
from pcmrs.tms.settings import Estimate, MepSettings
from pcmrs.tms.threshold import MotorThresholdEstimator

Points = list[list[float | None]]


@dataclass(frozen=True, slots=True)
class Response:
    """What one pulse evoked.

    Attributes:
        microvolts: Peak to peak; None where there is no measurement.
        latency: Until the response begins, s; None where there is none.
        problem: Why it says nothing about the muscle; empty where it does.
    """

    pulse: int
    intensity: float
    microvolts: float | None
    latency: float | None
    problem: str

    @property
    def counts(self) -> bool:
        return not self.problem


@dataclass(frozen=True, slots=True)
class Hunted:
    """A threshold's hunt over its pulses, numbered from 1.

    Attributes:
        responded: Pulse and intensity, percent, of those that evoked a response.
        silent: Of those that did not.
        estimates: What was thought of the threshold after each.
        low: Lower end of the interval of 95 %; a gap where the method states none.
        width: Of the interval.
        best: What is thought now, percent; None before the first pulse.
    """

    method: str
    finished: bool
    best: float
    responded: Points
    silent: Points
    estimates: Points
    low: Points
    width: Points


def responses(events: Iterable[tuple[float, Verdict | DeviceEvent]]) -> list[Response]:
    """Of the pulses among what was decided, in order."""
    results = (event.result for _, event in events if isinstance(event, Verdict) and event.result is not None)
    return [_response(result) for result in results if "pulse" in result and "mep" in result]


def waves(epoch: Epoch, settings: MepSettings) -> list[tuple[float, float]]:
    """A signal less offset and hum: ms since the pulse, and µV; nothing where it cannot be judged."""
    try:
        times, samples = waveform(epoch, settings)
    except RefusalError:
        return []
    microvolts = np.round(1e6 * samples, 2).tolist()
    return list(zip(np.round(1e3 * times, 2).tolist(), microvolts, strict=True))


def hunted(hunt: Mapping[str, Any] | None) -> Hunted | None:
    """A hunt as the journal has it; None where none has begun."""
    if hunt is None:
        return None
    whole = msgspec.convert(hunt, MotorThresholdEstimator)
    after = [
        _estimate(MotorThresholdEstimator(whole.settings, whole.pulses[:n])) for n in range(1, len(whole.pulses) + 1)
    ]
    numbered = list(enumerate(whole.pulses, start=1))
    bounds = [(n, e.low, e.high) for n, e in enumerate(after, start=1)]
    return Hunted(
        method=whole.settings.method,
        finished=whole.finished,
        best=_estimate(whole).threshold,
        responded=[[n, pulse.intensity] for n, pulse in numbered if pulse.responded],
        silent=[[n, pulse.intensity] for n, pulse in numbered if not pulse.responded],
        estimates=[[n, each.threshold] for n, each in enumerate(after, start=1)],
        low=[[n, low] for n, low, _ in bounds],
        width=[[n, None if low is None or high is None else high - low] for n, low, high in bounds],
    )


@lru_cache(maxsize=256)
def _estimate(hunt: MotorThresholdEstimator) -> Estimate:
    """Once for each pulse of a hunt that is shown again and again."""
    return hunt.estimate


def _response(result: Mapping[str, Any]) -> Response:
    mep = result["mep"]
    return Response(
        pulse=result["pulse"],
        intensity=result["intensity"],
        microvolts=None if mep is None else 1e6 * mep["peak_to_peak"],
        latency=None if mep is None else mep["latency"],
        problem=result.get("problem_text", ""),
    )
