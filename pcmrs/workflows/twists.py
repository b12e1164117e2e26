"""Twists of a tool, (6,): velocity (m/s) before angular velocity (rad/s), or a way (m) before a turn (rad). Pure."""

from __future__ import annotations

import numpy as np

from pcmrs.spatial import Floats


def within(twist: Floats, linear: float, angular: float) -> Floats:
    """A twist (6,), shortened where its translation (m/s) or its rotation (rad/s) is longer than these."""
    excess = max(float(np.linalg.norm(twist[:3])) / linear, float(np.linalg.norm(twist[3:])) / angular)
    return twist / excess if excess > 1.0 else twist
