"""The following experiment as a picture: errors over time, shaded where the tool did not count as aligned."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pcmrs.analysis.plots import BLUE, ORANGE, new_figure
from pcmrs_lab.experiment.following import Drawn

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHT = 1.9
"""Of one scenario, inches."""


def following_figure(runs: Sequence[Drawn]) -> Figure:
    """A panel for each scenario: true errors with and without compensation of the tracker's latency."""
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
        axes.plot(run.course.times, run.course.true_mm, color=color, linewidth=0.8, label=label)
        if run.result.compensated:
            blocked = ~np.array(run.course.allowed, dtype=bool)
            transform = axes.get_xaxis_transform()
            axes.fill_between(run.course.times, 0, 1, where=blocked, transform=transform, color="0.85", linewidth=0)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(f"{runs[0].result.scenario}\ntrue error, mm")
