"""The threshold experiment as a picture: errors over the true threshold, and the pulses they took."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pcmrs.analysis.plots import BLUE, GREEN, ORANGE, new_figure
from pcmrs_lab.experiment.thresholds import METHODS, Hunted, ThresholdReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = dict(zip(METHODS, (BLUE, GREEN, ORANGE), strict=True))
STYLES = dict(zip(METHODS, ("-", "--", ":"), strict=True))


def thresholds_figure(report: ThresholdReport, hunted: dict[str, list[Hunted]]) -> Figure:
    """Share of the subjects within an error, and within a number of pulses, by method."""
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
