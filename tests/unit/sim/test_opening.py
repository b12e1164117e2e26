"""Opening the simulated cell: only its devices, only good settings, and nothing left behind."""

import asyncio
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from pcmrs.clock import Clock
from pcmrs.devices.protocols import OpenDriver
from pcmrs.errors import ConfigurationError, UnknownOutcomeError
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats
from pcmrs_sim.opening import open_devices
from tests.unit.sim.cell_readings import HOME, next_frames

DRIVER: OpenDriver = open_devices  # the type checker proves it


def motion(start: Floats, goal: Floats) -> JointTrajectory:
    way = (1 - np.cos(np.linspace(0.0, np.pi, 200))) / 2
    return JointTrajectory(period=0.01, positions=(start + way[:, None] * (goal - start)).tolist())


async def test_nothing_is_left_behind(clock: Clock) -> None:
    before = asyncio.all_tasks()
    async with open_devices(("robot", "tracker"), {}, clock) as devices:
        await devices["robot"].connect()
        frames = asyncio.create_task(next_frames(devices, 10**6))
        following = asyncio.create_task(devices["robot"].follow(motion(HOME, HOME + 0.3)))
        await clock.sleep(0.2)
    assert len(await frames) > 5
    with pytest.raises(UnknownOutcomeError):
        await following
    assert asyncio.all_tasks() == before


@pytest.mark.parametrize(
    ("devices", "settings", "text"),
    [
        (("robot", "drill"), {}, "drill"),
        (("robot",), {"robot": {"model": "puma560"}}, "puma560"),
        (("robot",), {"robot": {"relief_mm": 6.0}}, "relief_mm"),
        (("robot",), {"sim": {"tracker": {"rate": 60}}}, "rate"),
        (("robot",), {"sim": {"seed": -1}}, "seed"),
        (("robot",), {"sim": {"phantom": "knee"}}, "phantom"),
    ],
)
async def test_bad_configuration_is_refused(
    devices: Sequence[str], settings: dict[str, Any], text: str, clock: Clock
) -> None:
    with pytest.raises(ConfigurationError, match=text):
        async with open_devices(devices, settings, clock):
            pass


async def test_only_the_asked_devices_are_opened(clock: Clock) -> None:
    async with open_devices(("tracker",), {"robot": {"model": "iiwa7"}}, clock) as devices:
        assert set(devices) == {"tracker"}
