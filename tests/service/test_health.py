"""What nodes say of their devices: in the log once, and in refusals for want of poses."""

from __future__ import annotations

import pytest
from structlog.testing import capture_logs

from pcmrs.devices.poses import PoseFeed
from pcmrs.errors import RefusalError
from pcmrs.messages import DeviceHealth
from pcmrs.service.watches.devices import HealthWatch
from pcmrs.service.watches.readiness import DeviceReadiness
from pcmrs.testing.clock import ManualClock


async def test_a_device_is_told_when_it_is_lost_for_another_reason_and_there_again() -> None:
    readiness = DeviceReadiness({"tracker"}, ManualClock())
    watch = HealthWatch(readiness, PoseFeed(ManualClock(), 0.25))
    with capture_logs() as told:
        for connected, text in (
            (True, ""),
            (False, "unplugged"),
            (False, "unplugged"),
            (False, "too hot"),
            (True, ""),
            (True, ""),
        ):
            watch.take("", DeviceHealth(device="tracker", connected=connected, text=text))
    assert [(each["event"], each.get("reason")) for each in told] == [
        ("device_not_connected", "unplugged"),
        ("device_not_connected", "too hot"),
        ("device_connected", None),
    ]
    assert readiness.complete


async def test_a_refusal_for_want_of_poses_says_what_the_tracker_says_of_itself() -> None:
    feed = PoseFeed(ManualClock(), 0.25)
    watch = HealthWatch(DeviceReadiness(set(), ManualClock()), feed)
    watch.take("", DeviceHealth(device="tracker", connected=False, text="Nothing listens there. Check its cable."))
    with pytest.raises(RefusalError, match=r"not been seen \(Nothing listens there. Check its cable\)\."):
        feed.newest("coil")
    watch.take("", DeviceHealth(device="tracker", connected=True))
    with pytest.raises(RefusalError, match=r"not been seen\."):
        feed.newest("coil")
