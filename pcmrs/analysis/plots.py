"""Figures of placements, pose logs and motor evoked potentials, and the parts that all figures share.

Placements and waveforms are drawn as in the paper's figures. People with colour blindness can distinguish the colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pcmrs.analysis.placements import PlacementError, PlacementTrial
from pcmrs.analysis.pose_log import seen
from pcmrs.formats.pose_log import PoseLog
from pcmrs.messages import Epoch
from pcmrs.spatial import Floats
from pcmrs.tms.mep import Mep, waveform
from pcmrs.tms.settings import MepSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"
"""Okabe, Ito, Color Universal Design (2008)."""

DPI = 150


def new_figure(width: float = 10.0, height: float = 4.5) -> Figure:
    """Return an empty figure that makes room for its labels.

    Args:
        width: Width, inches.
        height: Height, inches.
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def save_png(figure: Figure, path: Path) -> None:
    """Write a figure as a PNG file.

    Args:
        figure: The figure.
        path: File to be written.

    Raises:
        OSError: The file cannot be written.
    """
    figure.savefig(path, format="png", dpi=DPI)


ARROW_SHARE = 0.25
"""Length of the longest arrow as a share of the extent of the targets."""

SMALLEST_EXTENT_MM = 10.0
"""Extent used for targets at a single point, mm."""


def placement_figure(trials: Sequence[PlacementTrial], title: str) -> Figure:
    """Return two panels: both errors of each trial, and the error vectors at the targets in the image.

    Args:
        trials: One or more placements.
        title: Title of the figure.
    """
    figure = new_figure()
    figure.suptitle(title)
    errors = [item.error for item in trials]
    _draw_errors(figure.add_subplot(1, 2, 1), errors)
    targets = np.array([item.placement.planned.translation for item in trials])
    rotations = [item.placement.measured.rotation for item in trials]
    vectors = np.array([rotation @ error.vector for rotation, error in zip(rotations, errors, strict=True)])
    _draw_vectors(figure.add_subplot(1, 2, 2, projection="3d"), targets * 1000.0, vectors * 1000.0)
    return figure


def _draw_errors(axes: Any, errors: Sequence[PlacementError]) -> None:
    trials = np.arange(1, len(errors) + 1)
    distances_mm = np.array([error.distance for error in errors]) * 1000.0
    angles_deg = np.degrees([error.angle for error in errors])
    axes.bar(trials, distances_mm, color=BLUE)
    axes.axhline(distances_mm.mean(), color=BLUE, linestyle="--")
    axes.set_xlabel("trial")
    axes.set_ylabel("translation error, mm", color=BLUE)
    axes.xaxis.get_major_locator().set_params(integer=True)
    turned = axes.twinx()
    turned.plot(trials, angles_deg, "D", color=ORANGE)
    turned.axhline(angles_deg.mean(), color=ORANGE, linestyle=":")
    turned.set_ylim(bottom=0.0)
    turned.set_ylabel("rotation error, ° (lines: means)", color=ORANGE)


def _draw_vectors(axes: Any, targets_mm: Floats, vectors_mm: Floats) -> None:
    extent = max(float(np.ptp(targets_mm, axis=0).max()), SMALLEST_EXTENT_MM)
    longest = float(np.linalg.norm(vectors_mm, axis=1).max())
    scale = ARROW_SHARE * extent / longest if longest > 0.0 else 1.0
    axes.scatter(*targets_mm.T, color=BLUE, label="target")
    axes.quiver(*targets_mm.T, *(scale * vectors_mm).T, color=ORANGE, label=f"error, {scale:.3g} times its length")
    middle = (targets_mm.min(axis=0) + targets_mm.max(axis=0)) / 2.0
    half = (0.5 + ARROW_SHARE) * extent
    for name, center in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{name}lim")(center - half, center + half)
        getattr(axes, f"set_{name}label")(f"{name}, mm")
    axes.locator_params(nbins=5)
    axes.set_box_aspect(None, zoom=0.85)  # at full size the outermost label is cut off
    axes.legend(loc="upper left")


def pose_log_figure(log: PoseLog) -> Figure:
    """Return one panel per row name: translation against its median, per axis in mm; gaps stay gaps."""
    figure = new_figure(height=7.0)
    figure.suptitle(log.name)
    panels = figure.subplots(len(log.poses), 1, sharex=True)
    missing = np.full(3, np.nan)
    for axes, (name, poses) in zip(panels, log.poses.items(), strict=True):
        tracked = seen(poses)
        translations = np.array([missing if pose is None else pose.translation for pose in tracked])
        axes.set_ylabel(f"{name}, mm")
        if any(pose is not None for pose in tracked):
            deviations_mm = (translations - np.nanmedian(translations, axis=0)) * 1000.0
            for axis, color, values in zip("xyz", (BLUE, ORANGE, GREEN), deviations_mm.T, strict=True):
                axes.plot(values, ".-", color=color, label=axis, linewidth=0.8, markersize=3.0)
    panels[0].legend(loc="upper right", ncols=3)
    panels[-1].set_xlabel("sample")
    return figure


HEIGHT, MOST = 1.5, 12
"""Height of a waveform, inches, and the number of waveforms beyond which the height shrinks."""

SHOWN_BEFORE, SHOWN_AFTER = 0.020, 0.030
"""Time shown before the pulse and after the window, s."""

GRAY = "#777777"


def draw_mep(file: Path, epochs: Sequence[Epoch], meps: Sequence[Mep], settings: MepSettings) -> None:
    """Save `mep_figure` as a PNG file.

    Args:
        file: File to be written.
        epochs: Signals; at least one.
        meps: Results of `judge_mep` for them, in the same order.
        settings: Settings of `judge_mep`.

    Raises:
        OSError: The file cannot be written.
    """
    save_png(mep_figure(epochs, meps, settings), file)


def mep_figure(epochs: Sequence[Epoch], meps: Sequence[Mep], settings: MepSettings) -> Figure:
    """Return the waveforms without offset and hum, with the window, the two peaks and the onset of the response.

    Args:
        epochs: Signals; at least one. Each has its own scale.
        meps: Results of `judge_mep` for them, in the same order.
        settings: Settings of `judge_mep`.
    """
    figure = new_figure(width=8.0, height=1.2 + HEIGHT * min(len(epochs), MOST))
    panels = figure.subplots(len(epochs), 1, sharex=True, squeeze=False)[:, 0]
    for axes, epoch, mep in zip(panels, epochs, meps, strict=True):
        _draw_waveform(axes, epoch, mep, settings)
    panels[0].legend(loc="upper right", fontsize="small", ncols=2)
    panels[-1].set_xlabel("time since the pulse, ms")
    figure.supylabel("electromyogram, µV")
    return figure


def _draw_waveform(axes: Axes, epoch: Epoch, mep: Mep, settings: MepSettings) -> None:
    times, samples = waveform(epoch, settings)
    axes.axvspan(
        settings.window_start * 1e3, settings.window_end * 1e3, color=GRAY, alpha=0.15, linewidth=0.0, label="window"
    )
    axes.axvline(0.0, color=GRAY, linewidth=0.8, linestyle="--", label="pulse")
    axes.plot(times * 1e3, samples * 1e6, color=BLUE if mep.valid else GRAY, linewidth=0.9)
    peaks = [mep.trough, mep.peak]
    axes.plot(np.multiply(peaks, 1e3), np.interp(peaks, times, samples) * 1e6, "o", color=ORANGE, label="peaks")
    if mep.latency is not None:
        axes.axvline(mep.latency * 1e3, color=GREEN, linewidth=0.8, label="onset")
    axes.set_xlim(-SHOWN_BEFORE * 1e3, (settings.window_end + SHOWN_AFTER) * 1e3)
    low, high = _limits(times, samples, settings)
    axes.set_ylim(low * 1e6, high * 1e6)
    axes.set_title(_title(epoch, mep), fontsize="small", loc="left")


def _limits(times: Floats, samples: Floats, settings: MepSettings) -> tuple[float, float]:
    """Return limits, V, for which the response fills the panel and the stimulus artefact is cut off."""
    window = samples[(times >= settings.window_start) & (times <= settings.window_end)]
    room = max(0.15 * float(np.ptp(window)), 0.5 * settings.threshold_uv * 1e-6)
    return float(window.min()) - room, float(window.max()) + room


def _title(epoch: Epoch, mep: Mep) -> str:
    flags = [name for name in ("preactivated", "saturated", "artefact") if getattr(mep, name)]
    verdict = ", ".join(flags) if flags else ("response" if mep.present else "no response")
    latency = "" if mep.latency is None else f", from {mep.latency * 1e3:.1f} ms"
    return f"{epoch.muscle}, pulse {epoch.pulse}: {mep.peak_to_peak * 1e6:.0f} µV peak to peak{latency}: {verdict}"
