"""The picture of a calibration: how far every pose is from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pcmrs.analysis.plots import BLUE, ORANGE, new_figure, save_png
from pcmrs.cli.calibrate.solved import Solved


def draw_residuals(solved: Solved, path: Path) -> None:
    """Bars of the residuals per pose, the bad ones hatched, and their rms. Raises `OSError`."""
    figure = new_figure(10.0, 3.5 * len(solved.residuals))
    panels = figure.subplots(len(solved.residuals), squeeze=False)[:, 0]
    for axes, (unit, values) in zip(panels, solved.residuals.items(), strict=True):
        numbers, bad = np.arange(1, len(values) + 1), np.isin(np.arange(len(values)), solved.bad)
        axes.bar(numbers[~bad], values[~bad], color=BLUE, label="used")
        if solved.bad:
            axes.bar(numbers[bad], values[bad], color=ORANGE, hatch="//", label="left out")
        axes.axhline(solved.rms[unit], color="black", linestyle="--", label=f"rms {solved.rms[unit]:.3f} {unit}")
        axes.set(xlabel="pose", ylabel=f"residual ({unit})")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(solved.method)
    save_png(figure, path)
