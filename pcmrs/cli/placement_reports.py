"""Recorded placements and pose logs as reports: mm and degrees, for people and as JSON."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np

from pcmrs.analysis.placements import PlacementTrial, Summary, summarize
from pcmrs.analysis.pose_log import Track, analyse_track, check_loop
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
    """One row name of a pose log; `None` where too few poses are left. See `pcmrs.analysis.pose_log`."""

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
    """The errors of one or more placements."""
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
    """Jitter, drift, gaps and the agreement of the rows of a pose log."""
    loop = check_loop(log)
    return PoseLogReport(
        path=str(path),
        samples=log.samples,
        tracks=[_track(analyse_track(name, poses)) for name, poses in log.poses.items()],
        compared=0 if loop is None else loop.samples,
        max_deviation_mm=None if loop is None else loop.max_distance * 1000.0,
        max_deviation_deg=None if loop is None else math.degrees(loop.max_angle),
    )


def _track(track: Track) -> TrackReport:
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
