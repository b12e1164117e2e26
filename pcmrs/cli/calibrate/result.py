"""Result of a calibration: shown, drawn, written if it is good enough, and the exit status.

The picture of a calibration: how far every pose is from it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NoReturn

import click
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from pcmrs.analysis.plots import BLUE, ORANGE, new_figure, save_png
from pcmrs.calibration import Calibration, Kind, ToolType, next_version, write_calibration
from pcmrs.cli.calibrate.options import CalibrationLabel, ResultOptions
from pcmrs.cli.printing import say
from pcmrs.cli.running import EXIT_REJECTED
from pcmrs.cli.tables import Terminal
from pcmrs.clock import SystemClock
from pcmrs.errors import DegenerateMotionError, DegeneratePointsError, MirroredPointsError, PcmrsError, RefusalError
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Floats, Transform


def _draw_residuals(result: CalibrationResult, path: Path) -> None:
    """Draw the residuals per pose as bars, the bad ones hatched, and their rms.

    Args:
        result: The calibration.
        path: PNG file to write.

    Raises:
        OSError: It cannot be written.
    """
    figure = new_figure(10.0, 3.5 * len(result.residuals))
    panels = figure.subplots(len(result.residuals), squeeze=False)[:, 0]
    for axes, (unit, values) in zip(panels, result.residuals.items(), strict=True):
        numbers, bad = np.arange(1, len(values) + 1), np.isin(np.arange(len(values)), result.bad)
        axes.bar(numbers[~bad], values[~bad], color=BLUE, label="used")
        if result.bad:
            axes.bar(numbers[bad], values[bad], color=ORANGE, hatch="//", label="left out")
        axes.axhline(result.rms[unit], color="black", linestyle="--", label=f"rms {result.rms[unit]:.3f} {unit}")
        axes.set(xlabel="pose", ylabel=f"residual ({unit})")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(result.method)
    save_png(figure, path)


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """A solved calibration, good or not.

    Attributes:
        kind: Kind of the calibrated part.
        tool: Type of the tool; None for a pointer.
        method: Method, for the file.
        values: Values for ``--json``, SI.
        summary: Lines for people.
        residuals: Residuals of every pose, by unit: ``mm``, and ``deg`` if it has any; empty for given values.
        rms: Root mean square of the poses that fit, by unit.
        bad: Indices of the poses that do not fit.
        limits: Limits of the rms, by unit.
        transforms: Transforms for the file, by name.
        errors: Errors for the file, by unit; None for those of the residuals.
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
    errors: dict[str, float] | None = None

    def check_limits(self) -> None:
        """Refuse residuals over their limits.

        Raises:
            RefusalError: ``error_too_large``.
        """
        for unit, value in self.rms.items():
            limit = self.limits[unit]
            if not value <= limit:
                text = (
                    f"The poses deviate by {value:.3f} {unit} rms, the limit is {limit:g} {unit}: check that nothing "
                    "slips or bends and that the poses belong together, and take them again."
                )
                raise RefusalError("error_too_large", text, unit=unit, value=value, limit=limit)

    def as_calibration(self, label: CalibrationLabel, version: int) -> Calibration:
        """Return the content of the calibration file, dated now.

        Args:
            label: Name and validity of the calibrated part.
            version: Number of the version.
        """
        errors = self.rms if self.errors is None else self.errors
        return Calibration(
            kind=self.kind,
            type=self.tool or "",
            name=label.name or self.kind,
            serial=label.serial,
            version=version,
            cell=label.cell,
            method=self.method,
            date=datetime.fromtimestamp(int(SystemClock().wall()), UTC),
            valid_days=label.valid_days,
            error_mm=errors["mm"],
            error_deg=errors.get("deg", 0.0),
            transforms={name: _message(transform) for name, transform in self.transforms.items()},
        )


def _message(transform: Transform) -> PoseMessage:
    (x, y, z), (w, i, j, k) = transform.translation.tolist(), transform.quat_wxyz.tolist()
    return PoseMessage(position=(x, y, z), quat_wxyz=(w, i, j, k))


MOST_ROWS = 200
"""Limit of poses that are listed one by one."""


def conclude(request: ResultOptions, solve: Callable[[], CalibrationResult]) -> None:
    """Solve, show, draw and write a calibration, and end the command: exit status 0 usable, 1 refused.

    Args:
        request: Options of the command.
        solve: Solves the calibration.
    """
    try:
        result = solve()
    except (DegenerateMotionError, DegeneratePointsError, MirroredPointsError, RefusalError) as error:
        _end_refused(request, error, {})
    if request.plot is not None and result.residuals:
        _draw_residuals(result, request.plot)
    try:
        result.check_limits()
    except RefusalError as error:
        if not request.as_json:
            _show(result)
        _end_refused(request, error, result.values)
    written = _write(request.label, request.label.output, result) if request.label.output is not None else {}
    if request.as_json:
        say(json.dumps({"accepted": True, "reason": None, **result.values, **written}))
        return
    _show(result)
    if written:
        say(f"written: {written['file']}, version {written['version']}")


def _write(label: CalibrationLabel, output: Path, result: CalibrationResult) -> dict[str, Any]:
    version = next_version(output, result.kind, label.name or result.kind, label.serial)
    written = write_calibration(output, result.as_calibration(label, version))
    return {"file": str(output), "version": written.version, "sha256": written.sha256}


def _end_refused(request: ResultOptions, error: PcmrsError, values: dict[str, Any]) -> NoReturn:
    code = error.refusal_code if isinstance(error, RefusalError) else error.code
    if request.as_json:
        reason = {"code": code, "text": error.text, "fields": error.fields}
        say(json.dumps({"accepted": False, "reason": reason, **values}))
    say(f"{click.get_current_context().command_path}: {error.text}", err=True)
    sys.exit(EXIT_REJECTED)


def _show(result: CalibrationResult) -> None:
    for line in result.summary:
        say(line)
    if not result.residuals:
        return
    count = len(result.residuals["mm"])
    over = ", ".join(f"{value:.3f} {unit} (limit {result.limits[unit]:g})" for unit, value in result.rms.items())
    say(f"rms residual {over} over {count - len(result.bad)} of {count} poses")
    if result.bad:
        bad = ", ".join(str(index + 1) for index in result.bad)
        say(f"left out, because they do not fit the others: pose {bad}")
    if count <= MOST_ROWS:
        Terminal().print(_table(result))


def _table(result: CalibrationResult) -> Table:
    table = Table("pose", *result.residuals, "", box=SIMPLE_HEAD, title="residuals", title_justify="left")
    for index, row in enumerate(zip(*result.residuals.values(), strict=True)):
        table.add_row(str(index + 1), *(f"{value:.3f}" for value in row), "bad" if index in result.bad else "")
    return table
