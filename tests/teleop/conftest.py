"""The bench of the workflows is at hand here, too, and its tests do not wait for real."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pcmrs.simulated_time.loop import SimulatedLoop

sys.path.insert(0, str(Path(__file__).parents[1] / "workflows"))

SIMULATED = ("test_teleoperation.py", "test_teleop_session.py")


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Simulated time where no process and no terminal takes part."""
    if item.path.name in SIMULATED:
        return {"simulated": SimulatedLoop}
    return {"real": asyncio.new_event_loop}
