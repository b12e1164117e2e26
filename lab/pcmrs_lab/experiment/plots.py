"""Plots of the experiments on thresholds, following, hot-spots, and the Monte Carlo of the failure injections."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pcmrs.analysis.hotspot_map import draw_head, draw_map
from pcmrs.analysis.plots import BLUE, GREEN, ORANGE, new_figure
from pcmrs.formats.mesh import Mesh
from pcmrs_lab.experiment.following import Drawn
from pcmrs_lab.experiment.hotspots import NEAR, HotspotReport, SearchResult
from pcmrs_lab.experiment.monte_carlo import MonteCarloReport
from pcmrs_lab.experiment.thresholds import METHODS, ThresholdReport, ThresholdResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHT = 1.9
"""Height of the panel of one scenario, inches."""


def following_figure(runs: Sequence[Drawn]) -> Figure:
    """Return a panel for each scenario: true errors with and without compensation of the tracker's latency."""
    names = list(dict.fromkeys(run.result.scenario for run in runs))
    figure = new_figure(width=12.0, height=HEIGHT * len(names) + 1.0)
    figure.suptitle("Following a simulated head; shaded: treatment blocked (with compensation)")
    panels = figure.subplots(len(names), 1, squeeze=False)[:, 0]
    for axes, name in zip(panels, names, strict=True):
        _draw(axes, [run for run in runs if run.result.scenario == name])
    panels[-1].set_xlabel("time, s")
    panels[0].legend(loc="upper right")
    return figure


def _draw(axes: Axes, runs: Sequence[Drawn]) -> None:
    for run in runs:
        color, label = (BLUE, "compensated") if run.result.compensated else (ORANGE, "not compensated")
        axes.plot(run.series.times, run.series.true_mm, color=color, linewidth=0.8, label=label)
        if run.result.compensated:
            blocked = ~np.array(run.series.allowed, dtype=bool)
            transform = axes.get_xaxis_transform()
            axes.fill_between(run.series.times, 0, 1, where=blocked, transform=transform, color="0.85", linewidth=0)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(f"{runs[0].result.scenario}\ntrue error, mm")


HIGHEST_MM = 20.0


def hotspots_figure(report: HotspotReport, searched: dict[str, list[SearchResult]], mesh: Mesh) -> Figure:
    """Return the first subject's maps by both methods, and the error by pulse over all subjects.

    Args:
        report: Report of the experiment.
        searched: Searches by method.
        mesh: Surface of the head, m.
    """
    figure = new_figure(width=11.0, height=9.6)
    figure.suptitle(f"Hot-spots of {report.subjects} simulated subjects, seed {report.seed}; maps: subject 1")
    (head, errors), maps = figure.subplots(2, 2)
    draw_head(head, mesh, searched["adaptive"][0].search)
    for axes, (method, found) in zip(maps, searched.items(), strict=True):
        truth = found[0].subject.image_from_hotspot
        colours = draw_map(axes, mesh, found[0].search, truth)
        figure.colorbar(colours, ax=axes, label="expected peak-to-peak amplitude, µV")
        _draw_errors(errors, method, found)
    errors.axhline(NEAR * 1e3, color="black", linestyle=":")
    errors.set(xlabel="pulses", ylabel="distance of the estimate from the hot-spot, mm", ylim=(0.0, HIGHEST_MM))
    errors.legend()
    figure.legend(*maps[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, facecolor="lightgray")
    return figure


def _draw_errors(axes: Axes, method: str, found: list[SearchResult]) -> None:
    """Draw median and p95 over the subjects; a search that has ended keeps its last estimate."""
    longest = max(len(each.errors) for each in found)
    errors_mm = np.array([each.errors + each.errors[-1:] * (longest - len(each.errors)) for each in found]) * 1e3
    pulses = np.arange(1, longest + 1)
    colour = BLUE if method == "adaptive" else ORANGE
    for share, style, name in ((0.5, "-", "median"), (0.95, "--", "p95")):
        values = np.minimum(np.quantile(errors_mm, share, axis=0, method="inverted_cdf"), 10.0 * HIGHEST_MM)
        axes.plot(pulses, values, style, color=colour, label=f"{method}, {name}")


def monte_carlo_figure(report: MonteCarloReport) -> Figure:
    """Return the residuals of every row with the paper's and the limits, and the share of refused runs."""
    figure = new_figure(width=12.0)
    figure.suptitle(f"Failure injections, {report.runs} simulated runs of each row, seed {report.seed}")
    residuals, refused = figure.subplots(1, 2)
    _draw_residuals(residuals, report)
    _draw_refused(refused, report)
    return figure


def _draw_residuals(axes: Axes, report: MonteCarloReport) -> None:
    rows = [(row, row.residual_mm) for row in report.rows if row.residual_mm is not None]
    labels = [str(row.run) for row, _ in rows]
    at = np.arange(len(rows))
    spreads = [residual.sd or 0.0 for _, residual in rows]
    axes.errorbar(
        at, [residual.mean for _, residual in rows], spreads, fmt="o", color=BLUE, label="simulated, mean ± sd"
    )
    axes.plot(at, [row.published_residual_mm or np.nan for row, _ in rows], "^", color=ORANGE, label="paper")
    limits = [report.noise[row.workflow].residual_limit_mm for row, _ in rows]
    axes.step(at, limits, where="mid", color="black", linestyle="--", label="residual limit")
    axes.set_xticks(at, labels)
    axes.set_xlabel("run of the paper's table")
    axes.set_ylabel("mean residual of the landmarks, mm")
    axes.set_ylim(bottom=0.0)
    axes.legend()


def _draw_refused(axes: Axes, report: MonteCarloReport) -> None:
    at = np.arange(len(report.rows))
    colors = [BLUE if row.injection == "none" else ORANGE for row in report.rows]
    bars = axes.bar(at, [100.0 * row.refused / row.runs for row in report.rows], color=colors)
    for bar, row in zip(bars, report.rows, strict=True):
        if row.by_construction:
            bar.set(hatch="//", fill=False, edgecolor="black")
    axes.set_xticks(at, [str(row.run) for row in report.rows])
    axes.set_xlabel("run of the paper's table (blue: controls; hatched: refused by construction)")
    axes.set_ylabel("refused, %")
    axes.set_ylim(0.0, 105.0)


COLORS = dict(zip(METHODS, (BLUE, GREEN, ORANGE), strict=True))
STYLES = dict(zip(METHODS, ("-", "--", ":"), strict=True))


def thresholds_figure(report: ThresholdReport, hunted: dict[str, list[ThresholdResult]]) -> Figure:
    """Return the share of the subjects within an error, and within a number of pulses, by method.

    Args:
        report: Report of the experiment.
        hunted: Estimates of every subject, by method.
    """
    figure = new_figure(width=11.0)
    figure.suptitle(f"Motor thresholds of {report.subjects} simulated subjects, seed {report.seed}")
    errors, pulses = figure.subplots(1, 2, sharey=True)
    for method, found in hunted.items():
        ended = [each for each in found if each.estimate is not None]
        _draw_share(errors, method, [100.0 * abs(each.error) / each.threshold for each in ended], len(found))
        _draw_share(pulses, method, [each.pulses for each in ended], len(found))
    errors.set_xlabel("error, % of the threshold")
    errors.set_ylabel("subjects, %")
    errors.set_xlim(0.0, 10.0)
    pulses.set_xlabel("pulses")
    pulses.set_xlim(left=0.0)
    pulses.set_ylim(0.0, 100.0)
    pulses.legend(loc="lower right")
    for axes in (errors, pulses):
        axes.axhline(50.0, color="black", linewidth=0.5)
        axes.axhline(95.0, color="black", linewidth=0.5, linestyle="--")
    return figure


def _draw_share(axes: Axes, method: str, values: list[float], subjects: int) -> None:
    shares = 100.0 * np.arange(1, len(values) + 1) / subjects
    axes.step(
        np.sort(values),
        shares,
        where="post",
        color=COLORS[method],
        linestyle=STYLES[method],
        label=METHODS[method],
    )
