"""Plot of the placement experiment: every placement of every seed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pcmrs.analysis.plots import BLUE, GREEN, ORANGE, new_figure
from pcmrs_lab.experiment.placements import PlacementReport

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MEASURED, TRUE, REGISTRATION = (BLUE, "o", "tracker-measured"), (ORANGE, "^", "true"), (GREEN, "s", "registration")


def placements_figure(reports: Sequence[PlacementReport]) -> Figure:
    """Return three panels over the seeds, each with its mean: translation, rotation, registration error."""
    figure = new_figure(width=12.0)
    figure.suptitle(f"Placements of the {reports[0].tool}, {reports[0].workflow}: simulated cell")
    translation, rotation, registration = figure.subplots(1, 3)
    _draw(translation, reports, "translation_error_mm", MEASURED)
    _draw(translation, reports, "true_translation_error_mm", TRUE)
    translation.set_ylabel("translation error, mm")
    _draw(rotation, reports, "rotation_error_deg", MEASURED)
    _draw(rotation, reports, "true_rotation_error_deg", TRUE)
    rotation.set_ylabel("rotation error, °")
    _draw(registration, reports, "target_registration_error_mm", REGISTRATION)
    registration.set_ylabel("target registration error, mm")
    for axes in (translation, rotation, registration):
        axes.set_xlabel("seed")
        axes.set_xlim(
            reports[0].seed - 0.5, reports[-1].seed + 0.5
        )  # without limits the axis of a single seed would have a scale of hundredths
        axes.set_ylim(bottom=0.0)
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.legend()
    return figure


def _draw(axes: Any, reports: Sequence[PlacementReport], field: str, style: tuple[str, str, str]) -> None:
    color, marker, label = style
    values = [[getattr(trial, field) for trial in report.trials] for report in reports]
    seeds = np.repeat([report.seed for report in reports], [len(each) for each in values])
    axes.plot(seeds, np.concatenate(values), marker, color=color, alpha=0.6, markersize=4.0, label=label)
    axes.axhline(np.concatenate(values).mean(), color=color, linestyle="--")
