"""A cell in simulated time."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

import pytest

from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs_sim.opening import open_devices


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Simulated time for tests with the fixture `clock`; others use sockets and processes."""
    if "clock" in getattr(item, "fixturenames", ()):
        return {"simulated": SimulatedLoop}
    return {"real": asyncio.new_event_loop}


@pytest.fixture
async def clock() -> SimulatedClock:
    return SimulatedClock(asyncio.get_running_loop())


@pytest.fixture
async def cell(clock: SimulatedClock) -> AsyncIterator[Mapping[str, Any]]:
    async with open_devices(("robot", "tracker", "pointer", "scene"), {}, clock) as devices:
        yield devices
