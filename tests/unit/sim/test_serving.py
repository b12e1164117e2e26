"""What the simulated cell serves by itself."""

from typing import Any

import pytest
from structlog.testing import capture_logs

from pcmrs.clock import SystemClock
from pcmrs_sim.opening import open_devices
from pcmrs_sim.serving import local_addresses
from tests.unit.sim.kst_client import connected

KST = {"robot": {"driver": "kst"}}


@pytest.mark.parametrize(
    ("settings", "served"),
    [
        ({}, {}),
        ({"robot": {"driver": "sim"}, "tracker": {"driver": "sim"}}, {}),
        (KST, {"kst": ("127.0.0.1", 30001)}),
        ({**KST, "kst": {"port": 4000}}, {"kst": ("127.0.0.1", 4000)}),
        ({**KST, "kst": {"host": "localhost"}}, {"kst": ("localhost", 30001)}),
        ({**KST, "kst": {"host": "172.31.1.147"}}, {}),
        ({"tracker": {"driver": "ndi"}}, {"ndi": ("127.0.0.1", 8765)}),
        ({"tracker": {"driver": "ndi"}, "ndi": {"device": "127.0.0.1:9000"}}, {"ndi": ("127.0.0.1", 9000)}),
        ({"tracker": {"driver": "ndi"}, "ndi": {"device": "/dev/ttyUSB0"}}, {}),
        ({"tracker": {"driver": "ndi"}, "ndi": {"device": "polaris.lab:8765"}}, {}),
    ],
)
def test_only_what_a_driver_looks_for_on_this_machine(settings: dict[str, Any], served: dict[str, Any]) -> None:
    assert local_addresses(settings) == served


async def test_a_port_that_is_taken_is_logged_and_left_alone() -> None:
    with capture_logs() as first:
        async with open_devices(["scene"], {**KST, "kst": {"port": 0}}, SystemClock()):
            (served,) = [entry for entry in first if entry["event"] == "virtual_device_served"]
            port = served["port"]
            with capture_logs() as second:
                async with open_devices(["scene"], {**KST, "kst": {"port": port}}, SystemClock()) as devices:
                    assert "scene" in devices
            async with connected("127.0.0.1", port) as client:
                assert len(await client.joints()) == 7
    (refused,) = [entry for entry in second if entry["event"] == "virtual_device_not_served"]
    assert (refused["driver"], refused["port"]) == ("kst", port)
