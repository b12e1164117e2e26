"""Picture of the registration experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pcmrs.analysis.plots import BLUE, GREEN, ORANGE, new_figure
from pcmrs_lab.experiment.registrations import MethodErrors, RegistrationRow, RegistrationsReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def registrations_figure(report: RegistrationsReport) -> Figure:
    """Return a panel for each property: true errors of all methods, and the predicted error of the refinement."""
    names = list(dict.fromkeys(row.property for row in report.rows))
    figure = new_figure(width=3.2 * len(names))
    figure.suptitle(f"Registrations of a simulated head, {report.runs} runs of each point, seed {report.seed}")
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axes, name in zip(panels, names, strict=True):
        _draw(axes, [row for row in report.rows if row.property == name])
        axes.set_xlabel(name)
    panels[0].set_ylabel("rms error at the target, mm")
    panels[0].set_ylim(bottom=0.0)
    panels[0].legend()
    return figure


def _draw(axes: Axes, rows: list[RegistrationRow]) -> None:
    at = np.arange(len(rows))
    _line(axes, [row.landmarks for row in rows], "0.5", "landmarks")
    _line(axes, [row.refined for row in rows], BLUE, "refined")
    predicted = [row.refined.predicted_mm for row in rows]
    axes.plot(at, [np.nan if each is None else each for each in predicted], "_", color="black", label="predicted")
    _line(axes, [row.without_offset for row in rows], ORANGE, "without offset")
    _line(axes, [row.icp for row in rows], GREEN, "plain ICP")
    axes.set_xticks(at, [row.value for row in rows])


def _line(axes: Axes, errors: list[MethodErrors], color: str, label: str) -> None:
    values = [np.nan if each.true_mm is None else each.true_mm for each in errors]
    axes.plot(np.arange(len(values)), values, "o-", color=color, label=label)
