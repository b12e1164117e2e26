"""Trajectories and presses that an arm refuses, with the joint, the value and the limit."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from pcmrs.devices.motion._limits import START_TOLERANCE, check_press, check_trajectory
from pcmrs.errors import DeviceError
from pcmrs.messages import JointTrajectory, PressRequest
from pcmrs.spatial import Floats
from tests.unit.devices.spring import HOME, MODEL

FACTS = MODEL.facts
PERIOD = 0.01
PRESS = PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.010, speed=0.02, timeout=8.0)

joints = st.integers(0, 6)


def refusal(positions: list[Floats], posture: Floats = HOME) -> dict[str, Any]:
    """Return the fields of the refusal; none if the trajectory is accepted."""
    trajectory = JointTrajectory(period=PERIOD, positions=[each.tolist() for each in positions])
    try:
        check_trajectory(trajectory, posture, FACTS)
    except DeviceError as error:
        return error.fields
    return {}


def moved(joint: int, by: float, start: Floats = HOME) -> Floats:
    posture = start.copy()
    posture[joint] += by
    return posture


@given(joints, st.floats(-0.1, 0.1))
def test_a_start_elsewhere_is_refused_with_joint_and_distance(joint: int, by: float) -> None:
    fields = refusal([moved(joint, by)])
    if abs(by) <= START_TOLERANCE - 1e-9:
        assert fields == {}
    elif abs(by) > START_TOLERANCE + 1e-9:
        assert (fields["joint"], fields["limit"]) == (joint + 1, START_TOLERANCE)
        assert fields["distance"] == pytest.approx(abs(by))


@given(joints, st.booleans(), st.floats(1e-4, 1.0))
def test_a_range_may_be_used_whole_and_no_further(joint: int, upper: bool, excess: float) -> None:
    bound = (MODEL.upper if upper else MODEL.lower)[joint]
    start = HOME.copy()
    start[joint] = bound
    assert refusal([start], posture=start) == {}
    fields = refusal([start, moved(joint, excess if upper else -excess, start)], posture=start)
    assert fields["joint"] == joint + 1
    assert fields["excess"] == pytest.approx(excess)
    assert (fields["lower"], fields["upper"]) == (MODEL.lower[joint], MODEL.upper[joint])


@given(joints, st.sampled_from([-1.0, 1.0]), st.floats(1.001, 3.0))
def test_a_speed_may_be_used_whole_and_no_further(joint: int, sign: float, times: float) -> None:
    step = sign * MODEL.velocity[joint] * PERIOD
    assert refusal([HOME, moved(joint, step)]) == {}
    fields = refusal([HOME, moved(joint, times * step)])
    assert fields["joint"] == joint + 1
    assert fields["velocity"] == pytest.approx(times * MODEL.velocity[joint])
    assert fields["limit"] == MODEL.velocity[joint]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"period": 0.0}, "positive period"),
        ({"period": nan}, "positive period"),
        ({"period": inf}, "positive period"),
        ({"positions": []}, "present posture"),
        ({"positions": [HOME[:6].tolist()]}, "must have 7 joints"),
        ({"positions": [HOME.tolist(), [*HOME[:6], nan]]}, "not finite"),
    ],
)
def test_a_malformed_trajectory_is_refused(change: dict[str, Any], says: str) -> None:
    trajectory = JointTrajectory(period=PERIOD, positions=[HOME.tolist()])
    check_trajectory(trajectory, HOME, FACTS)
    with pytest.raises(DeviceError, match=says):
        check_trajectory(replace(trajectory, **change), HOME, FACTS)


@pytest.mark.parametrize(
    ("key", "allowed", "refused"),
    [
        ("force", [1.0, 5.0], [0.99, 5.01, nan]),
        ("travel", [1e-4, 0.010], [0.0, 0.0101, -0.001, nan]),
        ("speed", [1e-4, 0.05], [0.0, 0.051, nan]),
        ("timeout", [0.1, 20.0], [0.0, 20.1, inf]),
        ("direction_in_flange", [(0.6, 0.0, -0.8)], [(0.0, 0.0, 0.0), (0.0, 0.0, 1.01), (nan, 0.0, 0.0)]),
    ],
)
def test_a_press_that_is_not_gentle_is_refused(key: str, allowed: list[Any], refused: list[Any]) -> None:
    for value in allowed:
        check_press(replace(PRESS, **{key: value}))
    for value in refused:
        with pytest.raises(DeviceError, match="of a press is") as error:
            check_press(replace(PRESS, **{key: value}))
        given_ = float(np.linalg.norm(value)) if isinstance(value, tuple) else value
        assert error.value.fields["value"] == pytest.approx(given_, nan_ok=True)
