"""Tests of teleoperation without processes run in simulated time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from pcmrs.simulated_time.loop import SimulatedLoop

SIMULATED = ("test_teleoperation.py", "test_session.py")


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Simulated time where no process and no terminal takes part."""
    if item.path.name in SIMULATED:
        return {"simulated": SimulatedLoop}
    return {"real": asyncio.new_event_loop}
