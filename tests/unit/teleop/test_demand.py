"""Deflections become velocities: rest in the dead zone, and never more than the full speed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.teleop.demand import Mapping

deflections = st.floats(-1.5, 1.5)


@given(st.lists(deflections, min_size=6, max_size=6), st.floats(0.0, 0.9))
def test_untouched_device_asks_for_rest_and_none_for_overspeed(deflection: list[float], dead_zone: float) -> None:
    twist = Mapping(0.02, 0.2, dead_zone).twist(deflection)
    for each, given_, full in zip(twist, deflection, (0.02,) * 3 + (0.2,) * 3, strict=True):
        assert abs(each) <= full * (1 + 1e-12)
        assert each == 0.0 if abs(given_) <= dead_zone else each * given_ > 0.0 or abs(given_) - dead_zone < 1e-9
    assert Mapping(0.02, 0.2, dead_zone).twist([1.0] * 6) == pytest.approx((0.02,) * 3 + (0.2,) * 3)
