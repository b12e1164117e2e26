"""What the charts of the muscle show is what was measured."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.console.signals._responses import estimator_history, responses, waveform_points
from pcmrs.messages import Epoch, Verdict
from pcmrs.tms.settings import MepSettings, ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator


def test_a_hunt_is_drawn_as_it_went() -> None:
    hunt = MotorThresholdEstimator.begin(ThresholdSettings())
    while not hunt.finished:
        asked = hunt.next_intensity()
        hunt = hunt.after(asked, asked >= 55.0)
    shown = estimator_history(msgspec.to_builtins(hunt))
    assert shown is not None
    assert shown.finished
    assert shown.best == hunt.estimate.threshold
    assert len(shown.responded) + len(shown.silent) == len(shown.estimates) == len(hunt.pulses)
    assert all(intensity is not None and intensity >= 55.0 for _, intensity in shown.responded)
    last = len(hunt.pulses)
    assert hunt.estimate.low is not None
    assert hunt.estimate.high is not None
    assert shown.low[-1] == [last, hunt.estimate.low]
    assert shown.width[-1] == [last, pytest.approx(hunt.estimate.high - hunt.estimate.low)]
    assert estimator_history(None) is None


def test_hunt_without_interval_has_gaps_and_without_pulses_none() -> None:
    hunt = MotorThresholdEstimator.begin(ThresholdSettings(method="relative_frequency"))
    assert estimator_history(msgspec.to_builtins(hunt)).estimates == []  # type: ignore[union-attr]
    shown = estimator_history(msgspec.to_builtins(hunt.after(35.0, responded=False)))
    assert shown is not None
    assert (shown.low, shown.width) == ([[1, None]], [[1, None]])


def test_response_that_does_not_count_says_why() -> None:
    """A response without a measurement has no amplitude."""
    mep = {"peak_to_peak": 2e-4, "latency": 0.022}
    results: list[dict[str, Any] | None] = [
        {"pulse": 1, "intensity": 50.0, "mep": mep, "problem_text": ""},
        None,
        {"residual": 0.001},
        {"pulse": 2, "intensity": 50.0, "mep": mep, "problem_text": "The muscle was active."},
        {"pulse": 3, "intensity": 50.0, "mep": None, "problem_text": "No epoch."},
    ]
    verdicts = [
        (1.0, Verdict(id="1", branch="b", operation="o", decision="accepted", state="s", sequence=1, result=each))
        for each in results
    ]
    found = responses(verdicts)
    assert [each.counts for each in found] == [True, False, False]
    assert [each.microvolts for each in found] == [pytest.approx(200.0), pytest.approx(200.0), None]


def test_the_signal_is_shown_without_offset_and_hum() -> None:
    times = np.arange(-0.12, 0.1, 1 / 5000)
    samples = 3e-4 + 2e-5 * np.sin(2 * np.pi * 50 * times)
    epoch = Epoch(pulse=1, muscle="fdi", rate_hz=5000.0, start=-0.12, samples=samples.tolist())
    points = waveform_points(epoch, MepSettings())
    assert len(points) == len(times)
    assert points[0][0] == pytest.approx(-120.0)
    assert max(abs(value) for _, value in points) < 0.1
    assert waveform_points(msgspec.structs.replace(epoch, samples=[0.0]), MepSettings()) == []
