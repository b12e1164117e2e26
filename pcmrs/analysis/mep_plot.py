"""Motor evoked potentials as a picture: one waveform below the other, as the paper's figure shows those of subjects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pcmrs.analysis.plots import BLUE, GREEN, ORANGE, new_figure, save_png
from pcmrs.messages import Epoch
from pcmrs.spatial import Floats
from pcmrs.tms.mep import Mep, waveform
from pcmrs.tms.mep_settings import MepSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHT, MOST = 1.5, 12
"""Of a waveform, inches; more of them get lower."""

SHOWN_BEFORE, SHOWN_AFTER = 0.020, 0.030
"""How much is shown before the pulse and after the window, s."""

GRAY = "#777777"


def draw_mep(file: Path, epochs: Sequence[Epoch], meps: Sequence[Mep], settings: MepSettings) -> None:
    """Saves `mep_figure` as a PNG file. Raises `OSError` when that cannot be written."""
    save_png(mep_figure(epochs, meps, settings), file)


def mep_figure(epochs: Sequence[Epoch], meps: Sequence[Mep], settings: MepSettings) -> Figure:
    """The waveforms without offset and hum, with the window, the two peaks and the beginning of the response.

    Args:
        epochs: At least one; each is drawn to its own scale.
        meps: What `judge_mep` said of them, in the same order.
        settings: That it was told.
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
    """So that the response fills the panel, and the stimulus artefact is cut off; V."""
    window = samples[(times >= settings.window_start) & (times <= settings.window_end)]
    room = max(0.15 * float(np.ptp(window)), 0.5 * settings.threshold_uv * 1e-6)
    return float(window.min()) - room, float(window.max()) + room


def _title(epoch: Epoch, mep: Mep) -> str:
    flags = [name for name in ("preactivated", "saturated", "artefact") if getattr(mep, name)]
    said = ", ".join(flags) if flags else ("response" if mep.present else "no response")
    latency = "" if mep.latency is None else f", from {mep.latency * 1e3:.1f} ms"
    return f"{epoch.muscle}, pulse {epoch.pulse}: {mep.peak_to_peak * 1e6:.0f} µV peak to peak{latency}: {said}"
