"""What both calibrations hand to whoever shows and writes them.

The picture of a calibration: how far every pose is from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from pcmrs.analysis.plots import BLUE, ORANGE, new_figure, save_png
from pcmrs.calibration import Calibration, Kind, ToolType
from pcmrs.cli.calibrate.options import About
from pcmrs.clock import SystemClock
from pcmrs.errors import RefusalError
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Floats, Transform


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


@dataclass(frozen=True, eq=False)
class Solved:
    """A calibration that was worked out, good or not.

    Attributes:
        kind: Of what.
        tool: Type of a tool.
        method: How, for the file.
        values: What ``--json`` prints, SI.
        summary: Lines for people.
        residuals: Of every pose, by unit: ``mm``, and ``deg`` where it has one.
        rms: The same over the poses that fit.
        bad: Indices of those that do not.
        limits: By unit.
        transforms: For the file.
    """

    kind: Kind
    tool: ToolType | None
    method: str
    values: dict[str, Any]
    summary: list[str]
    residuals: dict[str, Floats]
    rms: dict[str, float]
    bad: tuple[int, ...]
    limits: dict[str, float]
    transforms: dict[str, Transform]

    def check_limits(self) -> None:
        """Raise `RefusalError` where a residual is over its limit."""
        for unit, value in self.rms.items():
            limit = self.limits[unit]
            if not value <= limit:
                text = (
                    f"The poses deviate by {value:.3f} {unit} rms, the limit is {limit:g} {unit}: see that nothing "
                    "slips or bends and that the poses belong together, and take them anew."
                )
                raise RefusalError("error_too_large", text, unit=unit, value=value, limit=limit)

    def as_calibration(self, about: About, version: int) -> Calibration:
        """The same as a calibration of a thing, dated now."""
        return Calibration(
            kind=self.kind,
            type=self.tool or "",
            name=about.name or self.kind,
            serial=about.serial,
            version=version,
            cell=about.cell,
            method=self.method,
            date=datetime.fromtimestamp(int(SystemClock().wall()), UTC),
            valid_days=about.valid_days,
            error_mm=self.rms["mm"],
            error_deg=self.rms.get("deg", 0.0),
            transforms={name: _message(transform) for name, transform in self.transforms.items()},
        )


def _message(transform: Transform) -> PoseMessage:
    (x, y, z), (w, i, j, k) = transform.translation.tolist(), transform.quat_wxyz.tolist()
    return PoseMessage(position=(x, y, z), quat_wxyz=(w, i, j, k))
