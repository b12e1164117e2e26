"""Every fault of the tracker leads to no pose, and the feed says why; when it ends, poses come back."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import aclosing
from typing import Any

import pytest

from pcmrs.clock import Clock
from pcmrs.devices.jumps import PoseLimits
from pcmrs.devices.poses import PoseFeed
from pcmrs.errors import RefusalError

LIMITS = PoseLimits(error=1e-3, speed=2.0, turn=20.0, steady=10)
MAX_AGE = 0.25
WHILE = 30
"""Frames of a fault: longer than a pose stays fresh; two had been exposed before it."""

Devices = Mapping[str, Any]


class Watch:
    """A feed that is given the frames of the cell's tracker."""

    def __init__(self, devices: Devices, clock: Clock) -> None:
        self.feed = PoseFeed(clock, MAX_AGE, LIMITS)
        self.scene = devices["scene"]
        self.clock = clock
        self._tracker = devices["tracker"]

    async def frames(self, count: int) -> None:
        async with aclosing(self._tracker.frames()) as frames:
            async for frame in frames:
                for pose in frame:
                    self.feed.update(pose)
                count -= 1
                if count == 0:
                    return

    def refusal(self, body: str) -> str:
        with pytest.raises(RefusalError) as refused:
            self.feed.newest(body)
        return f"{refused.value.refusal_code}: {refused.value.text}"


@pytest.fixture
async def watch(cell: Devices, clock: Clock) -> Watch:
    watch = Watch(cell, clock)
    await watch.frames(12)
    assert watch.feed.seen("coil")
    assert watch.feed.seen("body_ref")
    return watch


@pytest.mark.parametrize(
    ("fault", "arguments", "reason"),
    [
        ("occlude", {"body": "coil"}, "occluded"),
        ("frame_frozen", {}, "frame_not_advancing"),
        ("pose_nan", {"body": "coil"}, "no_pose"),
        ("pose_not_unit", {"body": "coil"}, "no_pose"),
        ("not_measured", {"body": "coil", "reason": "out_of_volume"}, "out_of_volume"),
        ("not_measured", {"body": "coil", "reason": "temperature"}, "temperature"),
        ("not_measured", {"body": "coil", "reason": "interference"}, "interference"),
        ("not_measured", {"body": "coil", "reason": "partially_out"}, "partially_out"),
        ("bad_fit", {"body": "coil"}, "fit_error"),
        ("phantom_marker", {"body": "coil"}, "jump"),
        ("tool_swap", {"first": "coil", "second": "body_ref"}, "swapped"),
        ("stamp_reversed", {}, "frame_not_advancing"),
        ("stamp_future", {}, "stamp_reversed"),
    ],
)
async def test_fault_hides_the_pose_and_is_its_reason_until_it_ends(
    watch: Watch, fault: str, arguments: dict[str, Any], reason: str
) -> None:
    await watch.scene.inject(fault, arguments | {"on": True})
    await watch.frames(WHILE)
    assert watch.feed.dropped[reason] >= WHILE - 3
    refusal = watch.refusal("coil")
    assert refusal.startswith("pose_stale")
    assert f"coil: {reason}" in refusal
    assert watch.feed.seen("body_ref") == ("body" in arguments), "the fault of one body is not that of another"
    await watch.scene.inject(fault, arguments | {"on": False})
    await watch.frames(LIMITS.steady + 2)
    assert watch.feed.seen("coil")
    assert watch.feed.seen("body_ref")


async def test_body_that_jumped_is_accepted_after_steady_frames(watch: Watch) -> None:
    before = watch.feed.newest("coil").translation
    await watch.scene.inject("pose_jump", {"body": "coil", "millimetres": 60.0})
    await watch.frames(LIMITS.steady)
    assert watch.feed.dropped["jump"] == LIMITS.steady
    assert watch.feed.newest("coil").translation.tolist() == before.tolist()
    await watch.frames(2)
    assert watch.feed.dropped["jump"] == LIMITS.steady
    assert watch.feed.newest("coil").translation[0] - before[0] == pytest.approx(0.06, abs=1e-3)


@pytest.mark.parametrize("fault", ["tracker_unplugged", "tracker_absent"])
async def test_a_tracker_that_sends_nothing_is_stale_and_comes_back(watch: Watch, fault: str) -> None:
    await watch.scene.inject(fault, {"on": True})
    await watch.clock.sleep(2 * MAX_AGE)
    assert watch.refusal("coil").startswith("pose_stale")
    await watch.scene.inject(fault, {"on": False})
    await watch.frames(3)
    assert watch.feed.seen("coil")


async def test_a_rate_that_falls_is_seen(watch: Watch) -> None:
    await watch.frames(60)
    assert watch.feed.rate_hz("coil") == pytest.approx(60.0, abs=3.0)
    await watch.scene.inject("tracker_rate", {"hertz": 5.0})
    await watch.frames(12)
    assert watch.feed.rate_hz("coil") == pytest.approx(5.0, abs=1.0)
    await watch.scene.inject("tracker_rate", {"hertz": 0.0})
    await watch.frames(70)
    assert watch.feed.rate_hz("coil") == pytest.approx(60.0, abs=3.0)
