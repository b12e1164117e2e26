"""Calibrated poses of tool and pointer, from calibration files or from the configuration."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from pcmrs.calibration import KINDS, Calibration, Kind, read_calibration
from pcmrs.errors import ConfigurationError, FileFormatError
from pcmrs.spatial import Transform
from pcmrs.workflows.settings import (
    SIMULATED_FLANGE_FROM_TOOL_MARKER,
    SIMULATED_TOOL_MARKER_FROM_TOOL_TIP,
    CalibrationSettings,
    PoseSetting,
)

__all__ = ["Mounting"]


@dataclass(frozen=True, eq=False)
class Mounting:
    """Calibrated poses of the tool and the pointer.

    Attributes:
        flange_from_tool_marker: Pose of the tool's marker body in the flange frame.
        tool_marker_from_tool_tip: Contact point and axes of the tool in its marker body.
        pointer_from_tip: Pose of the tip in the pointer's marker body.
        files: Calibration files in use, by kind.
        explicit: Poses of the configuration, by kind, of those without a file.
    """

    flange_from_tool_marker: Transform
    tool_marker_from_tool_tip: Transform
    pointer_from_tip: Transform
    files: Mapping[Kind, Calibration]
    explicit: Mapping[Kind, PoseSetting]

    @classmethod
    def read(cls, settings: CalibrationSettings) -> Mounting:
        """Read the calibration files that are configured, and take the configured poses otherwise.

        Raises:
            ConfigurationError: A calibration file cannot be read or is one of another kind, or the files of marker body
                and contact point are of two tools.
        """
        configured: dict[Kind, tuple[str, PoseSetting]] = {
            "tool": (settings.tool_file, settings.flange_from_tool_marker or SIMULATED_FLANGE_FROM_TOOL_MARKER),
            "tip": (settings.tip_file, settings.tool_marker_from_tool_tip or SIMULATED_TOOL_MARKER_FROM_TOOL_TIP),
            "pointer": (settings.pointer_file, settings.pointer_from_tip),
        }
        files = {kind: _read(kind, file) for kind, (file, _) in configured.items() if file}
        _check_same_tool(files)
        explicit = {kind: pose for kind, (file, pose) in configured.items() if not file}
        sources: dict[Kind, Calibration | PoseSetting] = {**files, **explicit}
        marker, tip, pointer = (sources[kind].transform() for kind in KINDS)
        return cls(marker, tip, pointer, files, explicit)

    @property
    def flange_from_tool_tip(self) -> Transform:
        """Pose of the tool's contact point in the flange frame."""
        return self.tool_tip(self.flange_from_tool_marker)

    @property
    def identity(self) -> str:
        """Short hash of all calibrations. Registrations with another hash are not comparable."""
        return self._hash([self._source(kind) for kind in KINDS])

    @property
    def pointer_identity(self) -> str:
        """Short hash of the pointer's calibration."""
        return self._hash(self._source("pointer"))

    @property
    def tip_error(self) -> float:
        """Rms error of the contact point in the marker body by its calibration file, m; 0 for a configured pose."""
        calibration = self.files.get("tip")
        return 0.0 if calibration is None else calibration.error_mm / 1000.0

    def tool_tip(self, frame_from_tool_marker: Transform) -> Transform:
        """Return the pose of the tool's contact point, in the frame in which the pose of its marker body is given.

        Args:
            frame_from_tool_marker: Pose of the marker body, such as the tracker measures it.
        """
        return frame_from_tool_marker @ self.tool_marker_from_tool_tip

    def _source(self, kind: Kind) -> str | PoseSetting:
        """Return the values of a calibration, not its path: a renamed file does not invalidate registrations."""
        return self.files[kind].content_hash() if kind in self.files else self.explicit[kind]

    @staticmethod
    def _hash(used: object) -> str:
        return hashlib.sha256(msgspec.json.encode(used)).hexdigest()[:16]


def _check_same_tool(files: Mapping[Kind, Calibration]) -> None:
    """Refuse a marker body and a contact point of two tools. Raises `ConfigurationError`."""
    if not {"tool", "tip"} <= files.keys():
        return
    marker, tip = files["tool"], files["tip"]
    if (marker.type, marker.serial) != (tip.type, tip.serial):
        text = (
            f"procedure.calibration: tool_file is of type {marker.type!r}, serial {marker.serial!r}, tip_file of "
            f"type {tip.type!r}, serial {tip.serial!r}: give two files of the same tool."
        )
        raise ConfigurationError(text)


def _read(kind: Kind, file: str) -> Calibration:
    """Return the calibration in a configured file. Raises `ConfigurationError`."""
    key = f"procedure.calibration.{kind}_file"
    try:
        found = read_calibration(Path(file))
    except FileFormatError as error:
        raise ConfigurationError(f"{key}: {error.text}", **error.fields) from None
    if found.kind != kind:
        raise ConfigurationError(f"{key}: {file} is the calibration of a {found.kind}.", file=file)
    return found
