"""What both calibrations hand to whoever shows and writes them."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from pcmrs.calibration import Calibration, Kind, ToolType
from pcmrs.cli.calibrate.options import About
from pcmrs.clock import SystemClock
from pcmrs.errors import RefusalError
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Floats, Transform


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
        """Raises `RefusalError` where a residual is over its limit."""
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
