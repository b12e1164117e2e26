"""Limits of a motion, and joint values as arrays."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import ConfigurationError, GeometryError
from pcmrs.kinematics.limits import joint_array
from tests.unit.kinematics.motions import LIMITS


@pytest.mark.parametrize(
    ("name", "value"),
    [("joint_velocity", (1.0,) * 6), ("joint_jerk", (0.0,) * 7), ("linear_velocity", -1.0), ("linear_jerk", np.inf)],
)
def test_limits_that_are_none_are_refused(name: str, value: Any) -> None:
    with pytest.raises(ConfigurationError, match=name):
        dataclasses.replace(LIMITS, **{name: value})


def test_joint_values_are_copied_so_that_a_caller_may_go_on() -> None:
    given_ = np.arange(7.0)
    array = joint_array(given_, 7)
    given_ += 1.0
    assert array.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


@pytest.mark.parametrize("values", [[0.0] * 6, [0.0] * 8, [[0.0] * 7], 0.0, [np.nan] * 7, [0.0] * 6 + [np.inf]])
def test_joint_values_of_another_arm_or_not_finite_are_refused(values: Any) -> None:
    with pytest.raises(GeometryError, match="7 finite numbers") as error:
        joint_array(values, 7)
    assert error.value.fields["joints"] == 7


@pytest.mark.parametrize("number", [0, 3, 6])
def test_one_limit_of_one_joint_that_is_not_positive_is_refused(number: int) -> None:
    for name in ("joint_velocity", "joint_acceleration", "joint_jerk"):
        for value in (0.0, -1.0, np.nan):
            values = [1.0] * 7
            values[number] = value
            change: dict[str, Any] = {name: tuple(values)}
            with pytest.raises(ConfigurationError, match="7 positive numbers") as error:
                dataclasses.replace(LIMITS, **change)
            assert error.value.fields["limit"] == name
