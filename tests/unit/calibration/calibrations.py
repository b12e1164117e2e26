"""A calibration for tests, and what may be said of it."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import msgspec

from pcmrs.calibration import Calibration
from pcmrs.messages import PoseMessage

DATE = datetime(2026, 3, 1, 12, 0, tzinfo=UTC)


def a_tool(**given: Any) -> Calibration:
    """A coil, with what the test says itself; hashed."""
    pose = PoseMessage(position=(0.001, -0.002, 0.15), quat_wxyz=(0.0, 1.0, 0.0, 0.0))
    values: dict[str, Any] = {
        "kind": "tool",
        "type": "coil",
        "name": "MC-B70",
        "serial": "17",
        "cell": "lab/cell1",
        "method": "hand-eye",
        "date": DATE,
        "valid_days": 100,
        "error_mm": 0.3,
        "transforms": {"flange_from_tool_marker": pose},
    }
    return hashed(Calibration(**(values | given)))


def a_pointer(**given: Any) -> Calibration:
    """A stylus, with what the test says itself; hashed."""
    pose = PoseMessage(position=(0.0, 0.0, -0.149), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
    return a_tool(
        **({"kind": "pointer", "type": "", "name": "stylus", "transforms": {"pointer_from_tip": pose}} | given)
    )


def hashed(calibration: Calibration) -> Calibration:
    return msgspec.structs.replace(calibration, sha256=calibration.content_hash())
