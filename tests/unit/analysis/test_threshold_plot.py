"""Figures of threshold hunts: they say what was found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcmrs.analysis.threshold_plot import draw_hunt, hunt_figure
from pcmrs.tms.settings import ThresholdMethod, ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs_sim.tms.recruitment import Recruitment


def hunt(method: ThresholdMethod, pulses: int) -> MotorThresholdEstimator:
    subject, rng = Recruitment(55.0), np.random.default_rng(1)
    made = MotorThresholdEstimator.begin(ThresholdSettings(method=method))
    while not made.finished and len(made.pulses) < pulses:
        amplitude = subject.sample(made.next_intensity(), rng)
        made = made.after(made.next_intensity(), amplitude >= 50e-6, amplitude)
    return made


@pytest.mark.parametrize("method", ["ml", "relative_frequency"])
@pytest.mark.parametrize(("pulses", "said"), [(0, "not finished"), (3, "not finished"), (200, "motor threshold")])
def test_hunts_are_drawn_at_any_time(tmp_path: Path, method: ThresholdMethod, pulses: int, said: str) -> None:
    made = hunt(method, pulses)
    (axes,) = hunt_figure(made).axes
    assert axes.get_title().startswith(said)
    assert f"{len(made.pulses)} pulses" in axes.get_title()
    draw_hunt(tmp_path / "hunt.png", made)
    assert (tmp_path / "hunt.png").read_bytes().startswith(b"\x89PNG")


def test_hunt_without_a_threshold_shows_why() -> None:
    made = MotorThresholdEstimator.begin(ThresholdSettings(ceiling=50.0))
    while made.refusal is None:
        made = made.after(made.next_intensity(), responded=False)
    (axes,) = hunt_figure(made).axes
    assert "above ceiling" in axes.get_title()
