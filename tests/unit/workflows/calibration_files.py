"""Calibration files that fit the simulated cell."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pcmrs.calibration import Calibration, write_calibration
from pcmrs.messages import PoseMessage
from pcmrs.testing.clock import EPOCH

TODAY = datetime.fromtimestamp(EPOCH, UTC)
TOOL = PoseMessage(position=(0.0, 0.0, 0.15), quat_wxyz=(0.0, 1.0, 0.0, 0.0))
TIP = PoseMessage(position=(0.0, 0.0, -0.15), quat_wxyz=(1.0, 0.0, 0.0, 0.0))


def calibrated(folder: Path, kind: str, **given: Any) -> dict[str, Any]:
    """Writes a calibration that fits the simulated cell; the settings that use it."""
    values = {
        "kind": kind,
        "type": "coil" if kind == "tool" else "",
        "name": f"the {kind}",
        "cell": "lab/cell1",
        "method": "test",
        "date": TODAY,
        "valid_days": 30,
        "error_mm": 0.2,
        "transforms": {"flange_from_coil": TOOL} if kind == "tool" else {"pointer_from_tip": TIP},
    }
    write_calibration(folder / f"{kind}.toml", Calibration(**(values | given)))
    return {"calibration": {f"{kind}_file": str(folder / f"{kind}.toml")}}
