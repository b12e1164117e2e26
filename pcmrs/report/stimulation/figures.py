"""Figures of a session with stimulation: hot-spot, hunt, responses, waveforms, placements."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pcmrs.analysis.hotspot_map import hotspot_figure
from pcmrs.analysis.plots import BLUE, GREEN, ORANGE, mep_figure, new_figure, save_png
from pcmrs.analysis.session import Phase, PulseRecord, SessionRecord
from pcmrs.analysis.threshold_plot import hunt_figure
from pcmrs.formats.mesh import Mesh
from pcmrs.tms.scalp import as_transform

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PHASES: dict[Phase, tuple[str, str, str]] = {
    "intensity": (GREEN, "s", "finding an intensity"),
    "hotspot": (BLUE, "o", "searching the hot-spot"),
    "threshold": (ORANGE, "^", "hunting the threshold"),
}
"""Colour, marker and name of each phase."""
WAVEFORMS = 6
"""Largest number of waveforms, from the largest response to the smallest."""
SMALLEST_UV = 1.0


def draw_figures(record: SessionRecord, mesh: Mesh, folder: Path) -> dict[str, Path]:
    """Draw the figures for which there are data; the map of triangles as PNG, all others as SVG.

    Args:
        record: The session.
        mesh: Surface of the head in the image, m.
        folder: Folder of the files. It must exist.

    Returns:
        Name of each figure to its file: ``hotspot``, ``hunt``, ``responses``, ``waveforms``, ``placements``.

    Raises:
        OSError: A file cannot be written.
    """
    drawn: dict[str, Path] = {}
    if record.search is not None and record.search.pulses:
        truth = None if record.truth is None else as_transform(record.truth.hotspot)
        figure = hotspot_figure(mesh, record.search, "Map of the responses", truth)
        drawn["hotspot"] = folder / "hotspot.png"
        save_png(figure, drawn["hotspot"])
    drawings: dict[str, Callable[[], Figure | None]] = {
        "hunt": lambda: None if record.hunt is None else hunt_figure(record.hunt),
        "responses": lambda: responses_figure(record),
        "waveforms": lambda: waveforms_figure(record),
        "placements": lambda: placements_figure(record),
    }
    for name, draw in drawings.items():
        drawing = draw()
        if drawing is not None:
            drawn[name] = folder / f"{name}.svg"
            drawing.savefig(drawn[name], format="svg", metadata={"Date": None})
    return drawn


def responses_figure(record: SessionRecord) -> Figure | None:
    """Return amplitude and intensity of each pulse; None without any measurement."""
    measured = [pulse for pulse in record.pulses if pulse.mep is not None]
    if not measured:
        return None
    figure = new_figure(width=9.0, height=4.6)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    for phase, (colour, marker, name) in PHASES.items():
        pulses = [pulse for pulse in measured if pulse.phase == phase]
        if pulses:
            _draw_amplitudes(upper, [pulse for pulse in pulses if not pulse.problem], colour, marker, name)
            lower.plot(
                *_against_number(pulses, [pulse.intensity for pulse in pulses]), marker, color=colour, markersize=3.5
            )
    _draw_amplitudes(upper, [pulse for pulse in measured if pulse.problem], "#555555", "x", "does not count")
    upper.axhline(
        record.mep_settings.threshold_uv, color="#777777", linewidth=0.8, linestyle="--", label="least response"
    )
    upper.set_yscale("log")
    upper.set_ylabel("peak to peak, µV")
    figure.legend(loc="outside upper left", fontsize="small", ncols=5, frameon=False)
    lower.set_ylabel("intensity, %")
    lower.set_xlabel("pulse")
    return figure


def waveforms_figure(record: SessionRecord) -> Figure | None:
    """Return some of the signals, from the largest response to the smallest; None without any."""
    shown = [(pulse.epoch, pulse.mep) for pulse in record.pulses if pulse.epoch is not None and pulse.mep is not None]
    if not shown:
        return None
    shown.sort(key=lambda each: -each[1].peak_to_peak)
    chosen = sorted(set(np.linspace(0, len(shown) - 1, WAVEFORMS).round().astype(int).tolist()))
    epochs, meps = zip(*(shown[index] for index in chosen), strict=True)
    return mep_figure(epochs, meps, record.mep_settings)


def placements_figure(record: SessionRecord) -> Figure | None:
    """Return the errors of each placement, and of the coil before each pulse; None without any placement."""
    placements = record.placements
    if not placements:
        return None
    figure = new_figure(width=9.0, height=3.4)
    minutes = np.array([placement.onset for placement in placements]) / 60.0
    at_pulse = np.array([pulse.onset for pulse in record.pulses]) / 60.0
    for axes, unit, placed, before in zip(
        figure.subplots(1, 2),
        ("mm", "°"),
        ([each.error_mm for each in placements], [each.error_deg for each in placements]),
        ([each.error_mm for each in record.pulses], [each.error_deg for each in record.pulses]),
        strict=True,
    ):
        axes.plot(at_pulse, before, ".", color=ORANGE, markersize=4, label="before a pulse, one frame")
        axes.plot(minutes, placed, "o", color=BLUE, markersize=3.5, label="placed, mean of frames")
        axes.set_xlabel("time, min of the cell")
        axes.set_ylabel(f"error, {unit}")
        axes.set_ylim(bottom=0.0)
    figure.axes[0].legend(loc="upper left", fontsize="small")
    return figure


def _draw_amplitudes(axes: Axes, pulses: list[PulseRecord], colour: str, marker: str, name: str) -> None:
    amplitudes = [max(SMALLEST_UV, 1e6 * pulse.mep.peak_to_peak) for pulse in pulses if pulse.mep is not None]
    if pulses:
        axes.plot(*_against_number(pulses, amplitudes), marker, color=colour, markersize=5, label=name)


def _against_number(pulses: list[PulseRecord], values: list[float]) -> tuple[list[int], list[float]]:
    return [pulse.pulse for pulse in pulses], values
