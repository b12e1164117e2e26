"""The following experiment: how the head moves, and what is shown of it; the following itself has tests of its own."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from pcmrs.analysis.plots import save_png
from pcmrs_lab.cli.experiment_tables import following_tables
from pcmrs_lab.experiment.error_series import ErrorSeries
from pcmrs_lab.experiment.following import Drawn, ErrorSummary, Followed, FollowingReport, Occluded
from pcmrs_lab.experiment.head_motions import scenarios
from pcmrs_lab.experiment.plots import following_figure
from pcmrs_sim.motion import check_motion, head_offset

DURATION = 20.0
MOTIONS = {each.name: each for each in scenarios(DURATION, seed=1)}


def drawn(scenario: str, *, compensated: bool) -> Drawn:
    series = ErrorSeries(times=[0.0, 1.0, 2.0, 3.0], true_mm=[0.1, 2.0, 3.0, 0.2], allowed=[True, True, False, True])
    spread = ErrorSummary(rms=0.123, p99=2.5, max=3.0)
    result = Followed(scenario, "as said", compensated, spread, spread, 0.75, 2.0, 0.0, lost=False)
    return Drawn(result, series)


RUNS = [drawn(name, compensated=compensated) for compensated in (False, True) for name in ("still", "steps")]


def report(*, latched: bool) -> FollowingReport:
    occlusion = Occluded(3.0, "held", "0", latched, 0.3)
    results = [run.result for run in RUNS]
    return FollowingReport("following", "ratms", 1, 1.0, DURATION, [], True, results, occlusion)


@pytest.mark.parametrize("name", MOTIONS)
def test_the_simulation_takes_every_motion(name: str) -> None:
    check_motion(MOTIONS[name].motion)


def test_the_head_drifts_as_far_as_in_half_an_hour() -> None:
    assert np.linalg.norm(head_offset(MOTIONS["drift"].motion, DURATION)) == pytest.approx(0.060)
    assert "90 times as fast" in MOTIONS["drift"].text


@pytest.mark.parametrize(("name", "farthest"), [("steps", 0.005), ("bursts", 0.0344)])
def test_the_head_goes_and_comes_back(name: str, farthest: float) -> None:
    way = np.array([head_offset(MOTIONS[name].motion, time) for time in np.arange(0.0, DURATION, 0.05)])
    assert np.linalg.norm(way, axis=1).max() == pytest.approx(farthest)
    assert np.linalg.norm(way[-1]) == pytest.approx(0.0, abs=1e-9)


def test_errors_while_blocked_do_not_count_as_allowed() -> None:
    assert RUNS[0].series.true_allowed_mm().tolist() == [0.1, 2.0, 0.2]


@pytest.mark.parametrize("latched", [True, False])
def test_the_table_says_what_became_of_a_hidden_head(latched: bool) -> None:
    console = Console(width=160, file=io.StringIO(), record=True)
    console.print(following_tables(report(latched=latched)))
    text = console.export_text()
    assert ("NOT latched" in text) != latched
    assert text.count("0.123") == 2 * len(RUNS)
    assert "75.0" in text


def test_the_picture_has_a_panel_for_each_motion(tmp_path: Path) -> None:
    figure = following_figure(RUNS)
    assert len(figure.axes) == 2
    save_png(figure, tmp_path / "following.png")
    assert (tmp_path / "following.png").stat().st_size > 1000
