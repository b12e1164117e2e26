"""Recorded placements and pose logs as reports and tables: mm and degrees, for people and as JSON."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from pcmrs.analysis.placements import PlacementTrial, Summary, summarize
from pcmrs.analysis.pose_log import PoseTrack, analyse_track, check_loop
from pcmrs.formats.pose_log import PoseLog
from pcmrs.spatial import Floats

Axes = tuple[float, float, float]


class TrialErrors(msgspec.Struct, frozen=True):
    """One placement; the vector is in the axes of the measured tool."""

    trial: str
    standoff_mm: float
    translation_error_mm: float
    rotation_error_deg: float
    error_vector_mm: Axes


class PlacementsReport(msgspec.Struct, frozen=True):
    """All trials of a folder or a journal."""

    path: str
    trials: list[TrialErrors]
    translation_error_mm: Summary
    rotation_error_deg: Summary


class TrackReport(msgspec.Struct, frozen=True):
    """One row name of a pose log; None if too few poses are left. See `pcmrs.analysis.pose_log`."""

    name: str
    missing: int
    identities: int
    frozen: int
    jitter_mm: Axes | None
    jitter_deg: Axes | None
    drift_mm: Axes | None
    drift_deg: Axes | None


class PoseLogReport(msgspec.Struct, frozen=True):
    """A pose log; the deviations are of body_tool from pol_body⁻¹ · pol_tool, over the samples that have all three."""

    path: str
    samples: int
    tracks: list[TrackReport]
    compared: int
    max_deviation_mm: float | None
    max_deviation_deg: float | None


def placements_report(path: Path, trials: list[PlacementTrial]) -> PlacementsReport:
    """Return the errors of one or more placements.

    Args:
        path: Their file or folder.
        trials: The placements.
    """
    errors = [_trial(trial) for trial in trials]
    return PlacementsReport(
        str(path),
        errors,
        summarize([trial.translation_error_mm for trial in errors]),
        summarize([trial.rotation_error_deg for trial in errors]),
    )


def _trial(trial: PlacementTrial) -> TrialErrors:
    error = trial.error
    return TrialErrors(
        trial=trial.placement.name,
        standoff_mm=trial.standoff * 1000.0,
        translation_error_mm=error.distance * 1000.0,
        rotation_error_deg=math.degrees(error.angle),
        error_vector_mm=_axes(error.vector * 1000.0),
    )


def pose_log_report(path: Path, log: PoseLog) -> PoseLogReport:
    """Return jitter, drift, gaps and the agreement of the rows of a pose log.

    Args:
        path: Its file.
        log: The pose log.
    """
    loop = check_loop(log)
    return PoseLogReport(
        path=str(path),
        samples=log.samples,
        tracks=[_track(analyse_track(name, poses)) for name, poses in log.poses.items()],
        compared=0 if loop is None else loop.samples,
        max_deviation_mm=None if loop is None else loop.max_distance * 1000.0,
        max_deviation_deg=None if loop is None else math.degrees(loop.max_angle),
    )


def _track(track: PoseTrack) -> TrackReport:
    spread = track.spread
    return TrackReport(
        name=track.name,
        missing=track.missing,
        identities=track.identities,
        frozen=track.frozen,
        jitter_mm=None if spread is None else _axes(spread.jitter * 1000.0),
        jitter_deg=None if spread is None else _axes(np.degrees(spread.rotation_jitter)),
        drift_mm=None if spread is None else _axes(spread.drift * 1000.0),
        drift_deg=None if spread is None else _axes(np.degrees(spread.rotation_drift)),
    )


def _axes(values: Floats) -> Axes:
    x, y, z = values.tolist()
    return x, y, z


def placements_tables(report: PlacementsReport) -> Group:
    """Return the errors of each trial, and mean, standard deviation and maximum of all."""
    trials = _table(f"Placements in {report.path}", "trial", "standoff mm", "mm", "°", "x y z mm, tool axes")
    for number, trial in enumerate(report.trials, start=1):
        trials.add_row(
            f"{number}  {trial.trial}",
            f"{trial.standoff_mm:g}",
            f"{trial.translation_error_mm:.4f}",
            f"{trial.rotation_error_deg:.4f}",
            _axes_text(trial.error_vector_mm),
        )
    summary = _table(f"Measured against planned, trials: {len(report.trials)}", "", "mean", "sd (n - 1)", "max")
    summary.add_row("translation error, mm", *_summary(report.translation_error_mm))
    summary.add_row("rotation error, °", *_summary(report.rotation_error_deg))
    return Group(trials, summary)


def pose_log_table(report: PoseLogReport) -> Table:
    """Return gaps, frozen frames, jitter and drift of each row name, and the agreement of the three."""
    names = ("row", "missing", "identity", "frozen", "jitter mm x y z", "jitter ° x y z", "drift mm x y z")
    table = _table(f"Pose log {report.path}, {report.samples} samples", *names)
    for track in report.tracks:
        table.add_row(
            track.name,
            str(track.missing),
            str(track.identities),
            str(track.frozen),
            _axes_text(track.jitter_mm),
            _axes_text(track.jitter_deg),
            _axes_text(track.drift_mm),
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
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for index, name in enumerate(columns):
        table.add_column(name, justify="right" if index else "left", no_wrap=True)
    return table


def _summary(summary: Summary) -> tuple[str, str, str]:
    return f"{summary.mean:.4f}", "-" if summary.sd is None else f"{summary.sd:.4f}", f"{summary.max:.4f}"


def _axes_text(values: Axes | None) -> str:
    return "-" if values is None else " ".join(f"{value:7.3f}" for value in values)
