"""Check of whether a calibration may be used here and now."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from pcmrs.calibration._file import COMMAND, Calibration, ToolType
from pcmrs.errors import RefusalError

CLOCK_TOLERANCE = timedelta(hours=1)
"""Limit for dates in the future. A later date means that the clock of this or of the calibrating machine is wrong."""


@dataclass(frozen=True, slots=True)
class ExpectedCalibration:
    """Cell, tool type and serial number for which a calibration must have been made.

    Attributes:
        cell: ``site/cell`` in which it is to be used.
        tool_type: Type of tool that the workflow needs; ignored for a pointer.
        serial: Serial number of the mounted tool or pointer; empty if it is not known.
    """

    cell: str
    tool_type: ToolType
    serial: str = ""


def check_valid(calibration: Calibration, expected: ExpectedCalibration, now: float) -> None:
    """Raise an error if a calibration must not be used.

    Args:
        calibration: Calibration as it was read.
        expected: Cell, tool type and serial number that it must have been made for.
        now: Present time, Unix seconds.

    Raises:
        RefusalError: ``calibration_changed``, ``calibration_foreign``, ``calibration_in_future`` or
            ``calibration_expired``.
    """
    _check_unchanged(calibration)
    _check_matches(calibration, expected)
    _check_date(calibration, datetime.fromtimestamp(now, UTC))


def _check_unchanged(calibration: Calibration) -> None:
    if calibration.sha256 != calibration.content_hash():
        text = (
            f"The file of the {calibration.kind} {calibration.title()} was changed after it was written: its values "
            f"do not give its hash. Bring back the original file, or calibrate again ({COMMAND[calibration.kind]})."
        )
        raise RefusalError("calibration_changed", text, name=calibration.name, recorded=calibration.sha256)


def _check_matches(calibration: Calibration, expected: ExpectedCalibration) -> None:
    fields = {
        "cell": (calibration.cell, expected.cell if calibration.cell else ""),
        "type": (calibration.type, "" if calibration.kind == "pointer" else expected.tool_type),
        "serial": (calibration.serial, expected.serial or calibration.serial),
    }
    for field, (found, needed) in fields.items():
        if found != needed:
            text = (
                f"The {calibration.kind} {calibration.title()} is calibrated for {field} {found!r}, but {needed!r} is "
                f"needed here: configure the right file in procedure.calibration.{calibration.kind}_file."
            )
            raise RefusalError("calibration_foreign", text, name=calibration.name, field=field, found=found)


def _check_date(calibration: Calibration, now: datetime) -> None:
    """Raise `RefusalError` if a calibration is dated in the future or has expired."""
    date, over = calibration.date.isoformat(), now - calibration.date - timedelta(days=calibration.valid_days)
    if calibration.date > now + CLOCK_TOLERANCE:
        text = (
            f"The {calibration.kind} {calibration.title()} is dated {date}, but it is {now.isoformat()} here: set the "
            "clock, or calibrate again."
        )
        raise RefusalError("calibration_in_future", text, name=calibration.name, date=date)
    if over >= timedelta(0):
        text = (
            f"The calibration of the {calibration.kind} {calibration.title()} was valid for {calibration.valid_days} "
            f"days and expired {over.days} days ago: calibrate again ({COMMAND[calibration.kind]})."
        )
        raise RefusalError(
            "calibration_expired", text, name=calibration.name, date=date, valid_days=calibration.valid_days
        )
