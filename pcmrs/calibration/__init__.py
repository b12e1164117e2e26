"""Calibrations of tools and pointers: the files that keep them, when they may be used, and the poses they come from."""

from pcmrs.calibration.file import Calibration, Kind, ToolType, next_version, read_calibration, write_calibration
from pcmrs.calibration.validity import Expected, check_valid

__all__ = [
    "Calibration",
    "Expected",
    "Kind",
    "ToolType",
    "check_valid",
    "next_version",
    "read_calibration",
    "write_calibration",
]
