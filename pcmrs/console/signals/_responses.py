"""Data of the muscle's charts: responses, signals and threshold estimates as points. Pure."""

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
class ChartedResponse:
    """Response to one pulse.

    Attributes:
        microvolts: Amplitude, peak to peak; None without a measurement.
        latency: Time until the response begins, s; None without a response.
        problem: Reason why it cannot be used; empty if it can.
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
class EstimatorHistory:
    """Estimates of a motor threshold over its pulses, numbered from 1.

    Attributes:
        responded: Pulse and intensity, percent, of pulses with a response.
        silent: Pulse and intensity, percent, of pulses without a response.
        estimates: Estimated threshold after each pulse, percent.
        low: Lower end of the 95 % interval; a gap if the method has none.
        width: Width of the interval.
        best: Present estimate, percent; None before the first pulse.
    """

    method: str
    finished: bool
    best: float
    responded: Points
    silent: Points
    estimates: Points
    low: Points
    width: Points


def responses(events: Iterable[tuple[float, Verdict | DeviceEvent]]) -> list[ChartedResponse]:
    """Return the responses to the pulses among the decisions, in order."""
    results = (event.result for _, event in events if isinstance(event, Verdict) and event.result is not None)
    return [_response(result) for result in results if "pulse" in result and "mep" in result]


def waveform_points(epoch: Epoch, settings: MepSettings) -> list[tuple[float, float]]:
    """Return a signal without offset and hum: ms since the pulse, and µV; nothing if it cannot be evaluated.

    Args:
        epoch: The signal.
        settings: Settings of the evaluation.
    """
    try:
        times, samples = waveform(epoch, settings)
    except RefusalError:
        return []
    microvolts = np.round(1e6 * samples, 2).tolist()
    return list(zip(np.round(1e3 * times, 2).tolist(), microvolts, strict=True))


def estimator_history(hunt: Mapping[str, Any] | None) -> EstimatorHistory | None:
    """Return the history of an estimator from its journalled state; None if there is none."""
    if hunt is None:
        return None
    whole = msgspec.convert(hunt, MotorThresholdEstimator)
    after = [
        _estimate(MotorThresholdEstimator(whole.settings, whole.pulses[:n])) for n in range(1, len(whole.pulses) + 1)
    ]
    numbered = list(enumerate(whole.pulses, start=1))
    bounds = [(n, e.low, e.high) for n, e in enumerate(after, start=1)]
    return EstimatorHistory(
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
    """Return the estimate, computed once for each pulse of an estimator that is shown again and again."""
    return hunt.estimate


def _response(result: Mapping[str, Any]) -> ChartedResponse:
    mep = result["mep"]
    return ChartedResponse(
        pulse=result["pulse"],
        intensity=result["intensity"],
        microvolts=None if mep is None else 1e6 * mep["peak_to_peak"],
        latency=None if mep is None else mep["latency"],
        problem=result.get("problem_text", ""),
    )
