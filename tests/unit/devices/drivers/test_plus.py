"""The driver for PLUS serves a tracker, with its own table."""

from __future__ import annotations

import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.drivers.plus import PlusSettings, open_devices
from pcmrs.errors import ConfigurationError


async def test_it_serves_a_tracker_only_and_checks_its_table() -> None:
    for devices, table in ((["robot"], {}), (["tracker"], {"prot": 1}), (["tracker"], {"names": {}})):
        with pytest.raises(ConfigurationError):
            async with open_devices(devices, {"plus": table}, SystemClock()):
                pass
    with pytest.raises(ConfigurationError, match="its own transform"):
        PlusSettings(names={"coil": "A", "pointer": "A"})
