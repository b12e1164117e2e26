"""Recorded placements and pose logs as tables."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.markup import escape
from rich.table import Table

from pcmrs.analysis.placements import Summary
from pcmrs.cli.placement_reports import Axes, PlacementsReport, PoseLogReport


def placements_tables(report: PlacementsReport) -> Group:
    """The errors of each trial, and mean, standard deviation and maximum of all."""
    trials = _table(f"Placements in {report.path}", "trial", "standoff mm", "mm", "°", "x y z mm, tool axes")
    for number, trial in enumerate(report.trials, start=1):
        trials.add_row(
            f"{number}  {escape(trial.trial)}",
            f"{trial.standoff_mm:g}",
            f"{trial.translation_error_mm:.4f}",
            f"{trial.rotation_error_deg:.4f}",
            _axes(trial.error_vector_mm),
        )
    summary = _table(f"Measured against planned, trials: {len(report.trials)}", "", "mean", "sd (n - 1)", "max")
    summary.add_row("translation error, mm", *_summary(report.translation_error_mm))
    summary.add_row("rotation error, °", *_summary(report.rotation_error_deg))
    return Group(trials, summary)


def pose_log_table(report: PoseLogReport) -> Table:
    """Gaps, frozen frames, jitter and drift of each row name, and the agreement of the three."""
    names = ("row", "missing", "identity", "frozen", "jitter mm x y z", "jitter ° x y z", "drift mm x y z")
    table = _table(f"Pose log {report.path}, {report.samples} samples", *names)
    for track in report.tracks:
        table.add_row(
            track.name,
            str(track.missing),
            str(track.identities),
            str(track.frozen),
            _axes(track.jitter_mm),
            _axes(track.jitter_deg),
            _axes(track.drift_mm),
        )
    agreement = "No sample has all three rows"
    if report.max_deviation_mm is not None and report.max_deviation_deg is not None:
        agreement = (
            f"body_tool is within {report.max_deviation_mm:.4f} mm and {report.max_deviation_deg:.4f}° of "
            f"pol_body⁻¹ · pol_tool in {report.compared} samples"
        )
    table.caption = f"{agreement}. Jitter: standard deviation around a straight line over the samples (n - 2)."
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=escape(title), box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for index, name in enumerate(columns):
        table.add_column(name, justify="right" if index else "left", no_wrap=True)
    return table


def _summary(summary: Summary) -> tuple[str, str, str]:
    return f"{summary.mean:.4f}", "-" if summary.sd is None else f"{summary.sd:.4f}", f"{summary.max:.4f}"


def _axes(values: Axes | None) -> str:
    return "-" if values is None else " ".join(f"{value:7.3f}" for value in values)
