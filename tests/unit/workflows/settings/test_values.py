"""A configured pose is a rigid transform, or is refused with its key."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from pcmrs.workflows.settings import CalibrationSettings
from pcmrs.workflows.settings._values import NotNegative, PoseSetting, Positive


def test_pose_turns_and_shifts_as_configured() -> None:
    """A quarter turn about z takes x to y."""
    half = math.sqrt(0.5)
    pose = msgspec.convert({"position": [1.0, 2.0, 3.0], "quat_wxyz": [half, 0.0, 0.0, half]}, PoseSetting)
    assert pose.transform() @ np.array((1.0, 0.0, 0.0)) == pytest.approx((1.0, 3.0, 3.0))
    assert PoseSetting().transform().matrix == pytest.approx(np.eye(4))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"position": [0.0, 0.0, 0.0], "quat_wxyz": [0.0, 0.0, 0.0, 0.0]}, "quaternion"),
        ({"position": [0.0, 0.0, 0.0], "quat_wxyz": [1.0, 1.0, 0.0, 0.0]}, "quaternion"),
        ({"position": [0.0, float("nan"), 0.0], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]}, "finite"),
        ({"position": [0.0, 0.0, 0.0]}, "quat_wxyz"),
        ({"quat_wxyz": [1.0, 0.0, 0.0, 0.0]}, "position"),
    ],
)
def test_pose_that_is_none_is_refused_with_its_key(values: object, words: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=rf"{words}.*\$\.flange_from_tool_marker"):
        msgspec.convert({"flange_from_tool_marker": values}, CalibrationSettings)


def test_zero_is_not_negative_but_not_positive() -> None:
    assert msgspec.convert(0.0, NotNegative) == 0.0
    for value, kind in ((0.0, Positive), (-1e-9, Positive), (-1e-9, NotNegative)):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert(value, kind)
