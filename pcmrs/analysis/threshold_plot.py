"""Figure of the hunt for a motor threshold: each pulse, and the estimate after it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pcmrs.analysis.plots import BLUE, GREEN, ORANGE, new_figure, save_png
from pcmrs.tms.threshold import MotorThresholdEstimator

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_hunt(file: Path, hunt: MotorThresholdEstimator) -> None:
    """Save `hunt_figure` as a PNG file.

    Args:
        file: File to be written.
        hunt: State of the hunt.

    Raises:
        OSError: The file cannot be written.
    """
    save_png(hunt_figure(hunt), file)


def hunt_figure(hunt: MotorThresholdEstimator) -> Figure:
    """Return the intensity and response of each pulse, and the estimate after it with its interval, if it has one."""
    from matplotlib.ticker import MaxNLocator

    figure = new_figure(width=8.0)
    axes = figure.subplots()
    _draw_estimates(axes, hunt)
    for responded, color, marker, label in ((True, BLUE, "o", "response"), (False, ORANGE, "x", "no response")):
        at = [number for number, pulse in enumerate(hunt.pulses, 1) if pulse.responded is responded]
        axes.plot(at, [hunt.pulses[n - 1].intensity for n in at], marker, color=color, label=label, linestyle="none")
    axes.set_title(_title(hunt))
    axes.set_xlabel("pulse")
    axes.set_ylabel("intensity, % of the maximum stimulator output")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(loc="best")
    return figure


def _draw_estimates(axes: Axes, hunt: MotorThresholdEstimator) -> None:
    """Draw the estimate after each pulse, computed from the pulses until then."""
    numbers = range(1, len(hunt.pulses) + 1)
    estimates = [MotorThresholdEstimator(hunt.settings, hunt.pulses[:number]).estimate for number in numbers]
    if hunt.settings.method == "ml":
        axes.plot(numbers, [each.threshold for each in estimates], "-", color=GREEN, label="estimate")
        lows = [each.low or 0.0 for each in estimates]
        highs = [each.high or 0.0 for each in estimates]
        axes.fill_between(numbers, lows, highs, color=GREEN, alpha=0.2, linewidth=0.0, label="95 % interval")
    elif hunt.finished:
        axes.axhline(hunt.estimate.threshold, color=GREEN, label="threshold")


def _title(hunt: MotorThresholdEstimator) -> str:
    found, pulses = hunt.estimate, len(hunt.pulses)
    if hunt.refusal is not None:
        return f"no threshold after {pulses} pulses: {hunt.refusal.replace('_', ' ')}"
    interval = "" if found.low is None or found.high is None else f", 95 % interval {found.low:g} % to {found.high:g} %"
    title = "motor threshold" if hunt.finished else "not finished:"
    return f"{title} {found.threshold:g} % after {pulses} pulses{interval}"
