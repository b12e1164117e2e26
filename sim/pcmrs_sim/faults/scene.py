"""Faults of the patient: a bumped reference, and a moving head."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcmrs.messages import HeadBurst, HeadMotion
from pcmrs.spatial import Transform
from pcmrs_sim.faults.fault import Fault, FaultTarget, number

LARGEST_BUMP_MM = 100.0
"""Largest slip of the reference, mm."""
LARGEST_SHIFT_MM = 2000.0
"""Largest shift of the patient, mm: out of the reach of any arm."""
LARGEST_SPEED_MM = 200.0
"""Largest speed of the head, mm/s."""
BURST_DURATION = 0.5
"""Duration of the head's motion, s."""


def _bump(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    offset = number(arguments, "millimetres", -LARGEST_BUMP_MM, LARGEST_BUMP_MM) * 1e-3
    cell.world.bump_reference(Transform.from_rotvec((offset, 0.0, 0.0), (0.0, 0.0, 0.0)))


def _shift(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    offset = number(arguments, "millimetres", -LARGEST_SHIFT_MM, LARGEST_SHIFT_MM) * 1e-3
    cell.world.shift_body(np.array((offset, 0.0, 0.0)))


def _dash(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    speed = number(arguments, "millimetres_per_second", 0.0, LARGEST_SPEED_MM) * 1e-3
    burst = HeadBurst(time=0.0, duration=BURST_DURATION, speed=speed, direction=(1.0, 0.0, 0.0))
    cell.world.set_motion(HeadMotion(bursts=[burst]))


FAULTS = (
    Fault("bump_reference", "S6", "The reference slips on the patient by this distance.", ("millimetres",), _bump),
    Fault("shift_body", "S5", "Patient and reference are displaced at once; 1500 is out of the arm's reach.",
          ("millimetres",), _shift, also=("B6",)),
    Fault("dash_head", "S12", "The head moves at this speed for half a second.", ("millimetres_per_second",), _dash),
)  # fmt: skip
"""Faults of the patient, for the registry `pcmrs_sim.faults.FAULTS`."""
