"""Calibrations of tools and pointers: their files, their validity, and the poses from which they are computed."""

from pcmrs.calibration._file import (
    KINDS,
    Calibration,
    Kind,
    ToolType,
    next_version,
    read_calibration,
    write_calibration,
)
from pcmrs.calibration._validity import ExpectedCalibration, check_valid

__all__ = [
    "KINDS",
    "Calibration",
    "ExpectedCalibration",
    "Kind",
    "ToolType",
    "check_valid",
    "next_version",
    "read_calibration",
    "write_calibration",
]
