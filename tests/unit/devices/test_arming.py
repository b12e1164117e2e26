"""Arming and pulse numbers of a stimulator, whatever the order of calls."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.arming import Arming
from pcmrs.errors import DeviceError


@given(st.lists(st.sampled_from(["arm", "disarm", "take", "wait"]) | st.integers(0, 6), max_size=40))
def test_pulse_numbers_only_grow_and_need_an_armed_stimulator(steps: list[str | int]) -> None:
    arming, now, given_ = Arming(10.0), 0.0, [0]
    for step in steps:
        now += 1.0
        if step == "arm":
            arming.arm(now)
        elif step == "disarm":
            arming.disarm()
        elif step == "wait":
            now += 20.0
            if arming.expired(now):
                assert arming.expiry().code == "disarmed"
        elif isinstance(step, int):
            try:
                arming.check(step)
            except DeviceError:
                assert step <= given_[-1] or not arming.armed
                continue
            assert arming.armed
            arming.take(step, now)
            given_.append(step)
    assert given_ == sorted(set(given_))
