"""Pictures of the experiments: each shows all runs, what was blocked or refused, and the paper's values beside."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from pcmrs.formats.mesh import Mesh
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs_lab.experiment import plots
from pcmrs_lab.experiment.hotspots import HotspotReport, SearchResult, SubjectQuantiles
from pcmrs_lab.experiment.plots import (
    HIGHEST_MM,
    following_figure,
    hotspots_figure,
    monte_carlo_figure,
    thresholds_figure,
)
from pcmrs_lab.experiment.thresholds import METHODS
from pcmrs_sim.tms.subject import Subject
from tests.unit.lab.experiment.example_reports import FOLLOWED, HUNTED, MONTE_CARLO, THRESHOLDS

pytest.importorskip("matplotlib")


def test_each_motion_has_panel_with_both_runs_and_blocked_times() -> None:
    figure = following_figure(FOLLOWED)
    assert [axes.get_ylabel().splitlines()[0] for axes in figure.axes] == ["still", "steps"]
    for axes in figure.axes:
        assert [line.get_label() for line in axes.lines] == ["not compensated", "compensated"]
        assert len(axes.collections) == 1, "only the run with compensation shows when treatment is blocked"


def test_rows_without_residual_are_no_points_and_hatched_bars() -> None:
    residuals, refused = monte_carlo_figure(MONTE_CARLO).axes
    assert [label.get_text() for label in residuals.get_xticklabels()] == ["1", "15"]
    (paper,) = [line for line in residuals.lines if line.get_label() == "paper"]
    assert np.array(paper.get_ydata()).tolist() == [2.5, 2.5]
    bars: list[Any] = list(refused.patches)
    assert [bar.get_height() for bar in bars] == [2.0, 100.0, 98.0]
    assert [bool(bar.get_hatch()) for bar in bars] == [False, True, False]


def test_subjects_without_a_threshold_keep_the_share_below_all() -> None:
    errors, pulses = thresholds_figure(THRESHOLDS, HUNTED).axes
    drawn = {line.get_label(): line for line in pulses.lines}
    for text in METHODS.values():
        assert np.array(drawn[text].get_ydata()).tolist() == pytest.approx([100.0 / 3.0, 200.0 / 3.0])
        assert np.array(drawn[text].get_xdata()).tolist() == [10, 14]
    assert np.array(errors.lines[0].get_xdata())[-1] == pytest.approx(2.5)


def test_a_search_that_has_ended_keeps_its_last_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """One without a response, whose error is infinite, is drawn above the axis."""
    monkeypatch.setattr(plots, "draw_head", lambda *_: None)
    monkeypatch.setattr(plots, "draw_map", lambda axes, *_: axes.scatter([0.0], [0.0], c=[1.0], label="hot-spot"))
    subject = cast(Subject, SimpleNamespace(image_from_hotspot=None))
    errors = ((float("inf"), 0.004, 0.003), (float("inf"), 0.002), (float("inf"),) * 3)
    found = [SearchResult(subject, cast(HotspotSearch, None), each, None) for each in errors]
    none = SubjectQuantiles(None, None)
    report = HotspotReport("hotspots", 1, 3, True, 120.0, none, [])
    figure = hotspots_figure(report, {"adaptive": found, "grid": found[:1]}, cast(Mesh, None))
    drawn = {line.get_label(): np.array(line.get_ydata()).tolist() for line in figure.axes[1].lines}
    assert drawn["adaptive, median"] == pytest.approx([10.0 * HIGHEST_MM, 4.0, 3.0])
    assert drawn["adaptive, p95"] == pytest.approx([10.0 * HIGHEST_MM] * 3)
    assert drawn["grid, median"][1:] == pytest.approx([4.0, 3.0])
