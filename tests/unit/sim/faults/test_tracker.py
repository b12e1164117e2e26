"""Faults of the tracker: their arguments and their rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from pcmrs.errors import DeviceError
from pcmrs_sim.faults.tracker import FAULTS

Devices = Mapping[str, Any]


@pytest.mark.parametrize(
    ("fault", "arguments"),
    [
        ("occlude", {"body": "nobody"}),
        ("occlude", {}),
        ("frame_frozen", {"on": "perhaps"}),
        ("not_measured", {"body": "coil", "reason": "boredom"}),
        ("pose_jump", {"body": "coil", "millimetres": float("nan")}),
        ("tool_swap", {"first": "coil"}),
        ("tracker_rate", {"hertz": -1.0}),
    ],
)
async def test_arguments_that_mean_nothing_are_refused(cell: Devices, fault: str, arguments: dict[str, Any]) -> None:
    with pytest.raises(DeviceError):
        await cell["scene"].inject(fault, arguments)


def test_every_sensor_row_of_the_tracker_has_its_fault() -> None:
    assert {fault.row for fault in FAULTS} == {"S1", "S2", "S3", "S4", "S5", "S7", "S8", "S9", "S10", "S11"}
