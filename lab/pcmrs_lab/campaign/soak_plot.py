"""Plot of the measures of a soak test."""

from __future__ import annotations

from pathlib import Path

from pcmrs.analysis.plots import BLUE, GREEN, ORANGE, new_figure, save_png
from pcmrs_lab.campaign.soaking import ALLOWED, SoakReport

COLOURS = {"daemon": BLUE, "node": ORANGE, "world": GREEN, "heart": "black"}


def draw_soak(report: SoakReport, path: Path) -> None:
    """Draw every measure over time; raise `OSError` if the file cannot be written.

    Args:
        report: Result of the soak test.
        path: PNG file to write.
    """
    figure = new_figure(10.0, 6.0)
    for axes, measure in zip(figure.subplots(2, 2).flat, ALLOWED, strict=True):
        scale = 1e6 if measure == "memory" else 1.0
        for trend in report.courses:
            if trend.measure == measure:
                values = [value / scale for value in trend.values]
                axes.plot([time / 60.0 for time in trend.times], values, color=COLOURS[trend.process], lw=1.2)
        axes.set_title("memory, MB" if measure == "memory" else measure)
        axes.set_xlabel("minutes")
        axes.set_ylim(bottom=0)
    colours = "daemon blue, node orange, simulated world green, heart black"
    figure.suptitle(f"Simulated cell under random operation: {colours}; {report.steps} commands")
    save_png(figure, path)
