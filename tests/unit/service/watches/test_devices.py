"""Reports of nodes about their devices are logged once."""

from __future__ import annotations

import pytest
from structlog.testing import capture_logs

from pcmrs.devices.poses import PoseFeed
from pcmrs.errors import RefusalError
from pcmrs.messages import DeviceHealth
from pcmrs.service.watches.devices import HealthWatch
from pcmrs.service.watches.readiness import DeviceReadiness
from pcmrs.testing.clock import ManualClock


async def test_device_is_logged_if_lost_for_a_new_reason_and_if_back() -> None:
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


async def test_refusal_for_lack_of_poses_has_the_tracker_trouble() -> None:
    feed = PoseFeed(ManualClock(), 0.25)
    watch = HealthWatch(DeviceReadiness(set(), ManualClock()), feed)
    watch.take("", DeviceHealth(device="tracker", connected=False, text="Nothing listens there. Check its cable."))
    with pytest.raises(RefusalError, match=r"not been seen \(Nothing listens there. Check its cable\)\."):
        feed.newest("coil")
    watch.take("", DeviceHealth(device="tracker", connected=True))
    with pytest.raises(RefusalError, match=r"not been seen\."):
        feed.newest("coil")
