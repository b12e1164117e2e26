"""Calibration files that fit the simulated cell."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pcmrs.calibration import Calibration, write_calibration
from pcmrs.messages import PoseMessage
from pcmrs.testing.clock import EPOCH
from pcmrs.workflows.settings import (
    SIMULATED_FLANGE_FROM_TOOL_MARKER,
    SIMULATED_TOOL_MARKER_FROM_TOOL_TIP,
    CalibrationSettings,
    PoseSetting,
)

TODAY = datetime.fromtimestamp(EPOCH, UTC)


def message(pose: PoseSetting) -> PoseMessage:
    return PoseMessage(position=pose.position, quat_wxyz=pose.quat_wxyz)


TRANSFORMS = {
    "tool": {"flange_from_tool_marker": message(SIMULATED_FLANGE_FROM_TOOL_MARKER)},
    "tip": {"tool_marker_from_tool_tip": message(SIMULATED_TOOL_MARKER_FROM_TOOL_TIP)},
    "pointer": {"pointer_from_tip": message(CalibrationSettings().pointer_from_tip)},
}


def calibrated(folder: Path, kind: str, **given: Any) -> dict[str, Any]:
    """Writes a calibration that fits the simulated cell, for a tool both of them; the settings that use it."""
    written = {f"{kind}_file": write(folder, kind, **given)}
    other = {"tool": "tip", "tip": "tool"}.get(kind)
    if other is not None:
        same = {name: given[name] for name in ("type", "serial") if name in given}
        written[f"{other}_file"] = write(folder, other, **same)
    return {"calibration": written}


def write(folder: Path, kind: str, **given: Any) -> str:
    """Writes one calibration; the path of its file."""
    values = {
        "kind": kind,
        "type": "" if kind == "pointer" else "coil",
        "name": f"the {kind}",
        "cell": "lab/cell1",
        "method": "test",
        "date": TODAY,
        "valid_days": 30,
        "error_mm": 0.2,
        "transforms": TRANSFORMS[kind],
    }
    write_calibration(folder / f"{kind}.toml", Calibration(**(values | given)))
    return str(folder / f"{kind}.toml")
