"""The driver ros2: its settings, and what it serves."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.protocols import OpenDriver
from pcmrs.errors import ConfigurationError
from pcmrs.ros2.driver import Ros2Settings, open_devices

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
