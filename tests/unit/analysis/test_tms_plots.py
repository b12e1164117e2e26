"""Pictures of responses and of threshold hunts: they say what was found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcmrs.analysis.plots import draw_mep, mep_figure
from pcmrs.analysis.threshold_plot import draw_hunt, hunt_figure
from pcmrs.messages import Epoch
from pcmrs.tms.mep import judge_mep
from pcmrs.tms.settings import MepSettings, ThresholdMethod, ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs_sim.tms.recruitment import Recruitment

RATE_HZ = 4000.0


def epoch(pulse: int, microvolts: float, rest_uv: float = 2.0) -> Epoch:
    times = -0.12 + np.arange(900) / RATE_HZ
    shape = np.where((times > 0.022) & (times < 0.032), np.sin((times - 0.022) * 2.0 * np.pi / 0.010), 0.0)
    noise = np.random.default_rng(pulse).normal(0.0, rest_uv * 1e-6, len(times))
    samples = 0.5e-6 * microvolts * shape + noise
    return Epoch(pulse=pulse, muscle="FDI", rate_hz=RATE_HZ, start=-0.12, samples=samples.tolist())


def hunt(method: ThresholdMethod, pulses: int) -> MotorThresholdEstimator:
    subject, rng = Recruitment(55.0), np.random.default_rng(1)
    made = MotorThresholdEstimator.begin(ThresholdSettings(method=method))
    while not made.finished and len(made.pulses) < pulses:
        amplitude = subject.sample(made.next_intensity(), rng)
        made = made.after(made.next_intensity(), amplitude >= 50e-6, amplitude)
    return made


def test_responses_are_drawn_with_what_was_found(tmp_path: Path) -> None:
    settings = MepSettings()
    epochs = [epoch(1, 300.0), epoch(2, 20.0), epoch(3, 300.0, rest_uv=15.0)]
    meps = [judge_mep(each, settings) for each in epochs]
    titles = [axes.get_title(loc="left") for axes in mep_figure(epochs, meps, settings).axes]
    assert [title.split(": ")[-1] for title in titles] == ["response", "no response", "preactivated"]
    assert "FDI, pulse 1" in titles[0]
    draw_mep(tmp_path / "mep.png", epochs, meps, settings)
    assert (tmp_path / "mep.png").read_bytes().startswith(b"\x89PNG")


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
