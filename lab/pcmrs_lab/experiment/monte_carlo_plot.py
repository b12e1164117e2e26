"""The Monte Carlo of the failure injections as a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pcmrs.analysis.plots import BLUE, ORANGE, new_figure
from pcmrs_lab.experiment.monte_carlo import MonteCarloReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def monte_carlo_figure(report: MonteCarloReport) -> Figure:
    """Residuals of every simulated row beside the paper's and the limits, and the share of each that is refused."""
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
