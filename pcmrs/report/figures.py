"""Figures of a report: states over time, landmarks, placements. The same report gives the same bytes."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pcmrs.analysis.placements import PlacementTrial
from pcmrs.analysis.plots import BLUE, GREEN, ORANGE, new_figure, placement_figure
from pcmrs.formats.pose_file import Placement as Poses
from pcmrs.report._contents import ReportedBranch, ReportedPlacement, ReportedRegistration, SessionReport
from pcmrs.workflows.data import as_transform

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_figures"]

WIDTH: Final = 7.1
"""Width of a page of A4 without its margins, inches."""
TINTS: Final = ("#dfe5ea", "#a9cbe3", "#5fa3d0", "#0072B2", "#9fd6c2", "#3aa886", "#c9b7dd", "#8a6fb0", "#e6d69a")
"""Colours of the states of a branch, in their order, and repeated if there are more."""
DOUBTFUL: Final = {"unknown": "#ffffff", "held": "#f2b48a"}
STOP: Final = "#b3261e"
FAULT: Final = ORANGE
READABLE: Final = 0.011
"""Width of a letter as a share of the figure: a span is labelled if its name fits in."""
STYLE: Final[dict[Any, Any]] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "svg.hashsalt": "pcmrs",
    "text.parse_math": False,  # names are text, also with a $ in them
}


def draw_figures(report: SessionReport) -> dict[str, bytes]:
    """Return the figures for which there are data, as SVG: ``timeline``, ``landmarks``, ``errors``, ``placements``."""
    import matplotlib as mpl

    measured = [placement for placement in report.placements if placement.axes_mm is not None]
    drawn: dict[str, bytes] = {}
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # the tables have every name in full
        if report.branches:
            drawn["timeline"] = _svg(_timeline(report))
        if report.registrations and report.registrations[-1].landmarks:
            drawn["landmarks"] = _svg(_landmarks(report.registrations[-1]))
        if measured:
            drawn["errors"] = _svg(_errors(measured))
            drawn["placements"] = _svg(_placements(measured))
    return drawn


def _timeline(report: SessionReport) -> Figure:
    """Draw the states of all branches over time, with stops and faults."""
    figure = new_figure(WIDTH, 0.8 + 0.27 * len(report.branches))
    axes = figure.add_subplot()
    whole = max(report.ended - report.begun, 1.0)
    for line, branch in enumerate(report.branches):
        _draw_branch(axes, line, branch, report.begun, whole)
    for colour, style, kind in ((STOP, "-", "stop"), (FAULT, "--", "fault")):
        for event in report.events:
            if event.kind == kind:
                axes.axvline((event.wall - report.begun) / 60.0, color=colour, linestyle=style, linewidth=1.0)
    for run in report.runs[1:]:
        axes.axvline((run.begun - report.begun) / 60.0, color="black", linestyle=":", linewidth=1.4)
    axes.set_yticks(range(len(report.branches)), [branch.name for branch in report.branches])
    axes.set_ylim(len(report.branches) - 0.4, -0.6)
    axes.set_xlim(0.0, whole / 60.0)
    axes.set_xlabel("minutes since the start")
    axes.tick_params(axis="y", length=0)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    _explain(figure, report)
    return figure


def _draw_branch(axes: Axes, line: int, branch: ReportedBranch, begun: float, whole: float) -> None:
    order = [*branch.states, *(span.state for span in branch.spans if span.state not in branch.states)]
    tints = {state: TINTS[index % len(TINTS)] for index, state in enumerate(dict.fromkeys(order))} | DOUBTFUL
    for span in branch.spans:
        left, length = (span.begun - begun) / 60.0, max(span.ended - span.begun, 0.0) / 60.0
        colour = tints[span.state]
        axes.barh(line, length, left=left, height=0.74, color=colour, edgecolor="#7b8791", linewidth=0.4)
        if length * 60.0 > READABLE * whole * (len(span.state) + 1):
            ink = "white" if colour in ("#0072B2", "#3aa886", "#8a6fb0") else "#1d2329"
            axes.text(left + length / 2, line, span.state, ha="center", va="center", fontsize=6.5, color=ink)


def _explain(figure: Figure, report: SessionReport) -> None:
    from matplotlib.lines import Line2D

    kinds = {event.kind for event in report.events}
    lines = [
        *([Line2D([], [], color=STOP, label="Stop")] if "stop" in kinds else []),
        *([Line2D([], [], color=FAULT, linestyle="--", label="fault")] if "fault" in kinds else []),
        *([Line2D([], [], color="black", linestyle=":", label="the daemon restarted")] if report.runs[1:] else []),
    ]
    if lines:
        figure.legend(handles=lines, loc="outside upper right", ncols=3, frameon=False, fontsize=7)


def _landmarks(registration: ReportedRegistration) -> Figure:
    """Draw the distance of each landmark, with the mean and its limit."""
    landmarks = registration.landmarks
    figure = new_figure(WIDTH, 0.9 + 0.22 * len(landmarks))
    axes = figure.add_subplot()
    axes.barh(range(len(landmarks)), [landmark.distance_mm for landmark in landmarks], height=0.62, color=BLUE)
    axes.set_yticks(range(len(landmarks)), [landmark.name.replace("_", " ") for landmark in landmarks])
    axes.invert_yaxis()
    if registration.residual_mm is not None:
        label = f"mean {registration.residual_mm:.2f} mm"
        axes.axvline(registration.residual_mm, color="#1d2329", linewidth=1.2, label=label)
    if registration.residual_limit_mm is not None:
        label = f"limit of the mean {registration.residual_limit_mm:.1f} mm"
        axes.axvline(registration.residual_limit_mm, color=STOP, linestyle="--", linewidth=1.2, label=label)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("distance after the fit, mm")
    _bare(axes)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside upper right", ncols=2, frameon=False, fontsize=7)
    return figure


def _errors(placements: Sequence[ReportedPlacement]) -> Figure:
    """Draw the translation error per axis of the tool with its length, and the rotation error, in two panels."""
    figure = new_figure(WIDTH, 2.5)
    left, right = figure.subplots(1, 2)
    trials = np.arange(1, len(placements) + 1)
    vectors = np.array([placement.axes_mm for placement in placements])
    for index, (name, colour) in enumerate((("x", BLUE), ("y", ORANGE), ("z", GREEN))):
        left.bar(trials + 0.26 * (index - 1), vectors[:, index], 0.26, color=colour, label=name)
    lengths = [placement.error_mm for placement in placements]
    left.plot(trials, lengths, "D", color="#1d2329", markersize=3.5, label="length")
    left.axhline(0.0, color="#1d2329", linewidth=0.6)
    left.set_ylabel("translation error, mm")
    left.legend(ncols=4, frameon=False, fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    right.bar(trials, [placement.error_deg for placement in placements], 0.5, color=BLUE)
    right.set_ylabel("rotation error, °")
    for axes in (left, right):
        axes.set_xlabel("placement")
        axes.set_xlim(0.3, len(placements) + 0.7)
        axes.xaxis.get_major_locator().set_params(integer=True)
        _bare(axes)
    return figure


def _placements(placements: Sequence[ReportedPlacement]) -> Figure:
    """Draw the paper's two panels: both errors of each placement, and the error vectors at the targets."""
    trials = [
        PlacementTrial(
            Poses(str(each.sequence), as_transform(each.planned), as_transform(each.measured)), each.standoff
        )
        for each in placements
        if each.planned is not None and each.measured is not None
    ]
    return placement_figure(trials, "")


def _bare(axes: Any) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _svg(figure: Figure) -> bytes:
    written = io.BytesIO()
    figure.savefig(written, format="svg", metadata={"Date": None})
    return written.getvalue()
