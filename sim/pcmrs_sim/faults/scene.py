"""Faults of the patient: a reference that is bumped, a head that moves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcmrs.messages import HeadBurst, HeadMotion
from pcmrs.spatial import Transform
from pcmrs_sim.faults.fault import Fault, Faulty, number

FARTHEST_MM = 100.0
FARTHEST_SHIFT_MM = 2000.0
"""Farther than any arm reaches."""
FASTEST_MM = 200.0
BURST = 0.5
"""So long the head moves, s."""


def _bump(cell: Faulty, arguments: Mapping[str, Any]) -> None:
    offset = number(arguments, "millimetres", -FARTHEST_MM, FARTHEST_MM) * 1e-3
    cell.world.bump_reference(Transform.from_rotvec((offset, 0.0, 0.0), (0.0, 0.0, 0.0)))


def _shift(cell: Faulty, arguments: Mapping[str, Any]) -> None:
    offset = number(arguments, "millimetres", -FARTHEST_SHIFT_MM, FARTHEST_SHIFT_MM) * 1e-3
    cell.world.shift_body(np.array((offset, 0.0, 0.0)))


def _dash(cell: Faulty, arguments: Mapping[str, Any]) -> None:
    speed = number(arguments, "millimetres_per_second", 0.0, FASTEST_MM) * 1e-3
    burst = HeadBurst(time=0.0, duration=BURST, speed=speed, direction=(1.0, 0.0, 0.0))
    cell.world.set_motion(HeadMotion(bursts=[burst]))


FAULTS = (
    Fault("bump_reference", "S6", "The reference slips on the patient by so much.", ("millimetres",), _bump),
    Fault("shift_body", "S5", "The patient is elsewhere at once, with the reference; 1500 is out of the arm's reach.",
          ("millimetres",), _shift, also=("B6",)),
    Fault("dash_head", "S12", "The head moves at such a speed for half a second.", ("millimetres_per_second",), _dash),
)  # fmt: skip
"""What `pcmrs_sim.faults` knows of the patient."""
