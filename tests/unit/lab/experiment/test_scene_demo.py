"""Braking and standstill are found in the joints after the image."""

from __future__ import annotations

import math

import pytest

from pcmrs.messages import JointState
from pcmrs_lab.experiment.scene_demo import _braking


def joints(at: float, position: float, speed: float) -> tuple[float, JointState]:
    state = JointState(captured=at, sent=at, positions=[0.0, position], velocities=[0.0, -speed], torques=[0.0, 0.0])
    return at, state


def test_times_count_from_the_image() -> None:
    course = [
        joints(0.9, 0.0, 0.5),
        joints(1.0, 0.05, 0.5),
        joints(1.05, 0.075, 0.55),
        joints(1.1, 0.09, 0.4),
        joints(1.2, 0.11, 0.1),
        joints(1.3, 0.12, 0.0),
        joints(1.4, 0.12, 0.0),
    ]
    braking, standing, travelled = _braking(course, 1.02)
    assert braking == pytest.approx(0.08)
    assert standing == pytest.approx(0.28)
    assert travelled == pytest.approx(0.07)
    assert math.degrees(travelled) == pytest.approx(4.0, abs=0.1)
