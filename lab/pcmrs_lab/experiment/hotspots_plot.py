"""The hot-spot experiment as a picture: the maps of one subject on the head, and the errors of all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pcmrs.analysis.hotspot_map import draw_head, draw_map
from pcmrs.analysis.plots import BLUE, ORANGE, new_figure
from pcmrs.formats.mesh import Mesh
from pcmrs_lab.experiment.hotspots import NEAR, HotspotReport, Searched

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HIGHEST_MM = 20.0


def hotspots_figure(report: HotspotReport, searched: dict[str, list[Searched]], mesh: Mesh) -> Figure:
    """The first subject's maps by both methods, and the distance from the hot-spot pulse by pulse over all subjects."""
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


def _draw_errors(axes: Axes, method: str, found: list[Searched]) -> None:
    """Median and p95 over the subjects; a search that has ended keeps its last estimate."""
    longest = max(len(each.errors) for each in found)
    errors_mm = np.array([each.errors + each.errors[-1:] * (longest - len(each.errors)) for each in found]) * 1e3
    pulses = np.arange(1, longest + 1)
    colour = BLUE if method == "adaptive" else ORANGE
    for share, style, name in ((0.5, "-", "median"), (0.95, "--", "p95")):
        values = np.minimum(np.quantile(errors_mm, share, axis=0, method="inverted_cdf"), 10.0 * HIGHEST_MM)
        axes.plot(pulses, values, style, color=colour, label=f"{method}, {name}")
