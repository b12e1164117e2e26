"""The driver ros2: its settings, and what it serves."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from structlog.testing import capture_logs

from pcmrs.clock import SystemClock
from pcmrs.devices.protocols import OpenDriver
from pcmrs.errors import ConfigurationError
from pcmrs.ros2.driver import Ros2Settings, open_devices
from pcmrs.settings import read_settings
from tests.unit.bus.bus_cells import new_cell, open_bus

DRIVER: OpenDriver = open_devices  # the type checker proves it
BODIES = ("coil", "body_ref", "pointer")
CLOCK = SystemClock()


@pytest.mark.parametrize(
    "table",
    [{"names": {}}, {"names": {"coil": "a", "body_ref": "a"}}, {"names": {"coil": "a/b"}}, {"max_age": 2.0}, {"n": 1}],
)
async def test_a_table_that_cannot_be_meant_is_refused(table: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError):
        async with open_devices(["tracker"], {"ros2": table}, CLOCK):
            pass


async def test_only_a_tracker_is_served() -> None:
    with pytest.raises(ConfigurationError, match="robot"):
        async with open_devices(["robot"], {}, CLOCK):
            pass


def test_the_defaults_are_the_bodies_of_a_cell() -> None:
    assert msgspec.to_builtins(Ros2Settings())["names"] == {body: body for body in BODIES}


async def test_unsealed_poses_are_off_by_default_and_reported_at_start() -> None:
    assert "ros2" not in read_settings().drivers()
    settings = new_cell()
    cell = {"endpoint": settings.endpoint, "site": settings.site, "name": settings.cell}
    async with open_bus(settings):
        with capture_logs() as logs:
            async with open_devices(["tracker"], {"cell": cell}, CLOCK):
                pass
    (warning,) = [entry for entry in logs if entry["event"] == "tracker_not_sealed"]
    assert warning["log_level"] == "warning"
    assert "ros2/tracker/*" in warning["text"]
