"""The table ``kst``: what a cabinet cannot do is refused at the start."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.kst.settings import UNIT_TOLERANCE, KstSettings


@pytest.mark.parametrize(
    ("key", "allowed", "refused"),
    [
        ("port", [1, 65535], [0, 65536]),
        ("connect_timeout", [0.1, 10.0], [0.0, 10.1]),
        ("reply_timeout", [0.01, 2.0], [0.0, 2.1]),
        ("rate_hz", [200.0, 1000.0], [199.0, 1001.0]),
        ("mode", ["servo", "impedance"], ["position", ""]),
        ("brake_acceleration", [0.1], [0.0, -10.0]),
        ("brake_jerk", [0.1], [0.0]),
        ("pose_limit", [0.001], [0.0]),
    ],
)
def test_each_value_has_its_range(key: str, allowed: list[Any], refused: list[Any]) -> None:
    for value in allowed:
        assert getattr(msgspec.convert({key: value}, KstSettings), key) == value
    for value in refused:
        with pytest.raises(msgspec.ValidationError, match=rf"`\$.{key}`"):
            msgspec.convert({key: value}, KstSettings)


@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).filter(lambda axis: np.linalg.norm(axis) > 0.1))
def test_only_a_unit_vector_is_a_tool_axis(axis: list[float]) -> None:
    """A longer one would scale the force along the tool, and the relief."""
    unit = np.array(axis) / np.linalg.norm(axis)
    assert msgspec.convert({"tool_axis": unit.tolist()}, KstSettings).tool_axis == tuple(unit)
    for scale in (1.0 - 2.0 * UNIT_TOLERANCE, 1.0 + 2.0 * UNIT_TOLERANCE, 0.0, -2.0):
        with pytest.raises(msgspec.ValidationError, match="must be a unit vector"):
            msgspec.convert({"tool_axis": (scale * unit).tolist()}, KstSettings)
