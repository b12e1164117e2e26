"""The bench of the workflows is at hand here, too, and its tests do not wait for real."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pcmrs.simulated_time.loop import SimulatedLoop

TESTS = Path(__file__).parents[1]
sys.path += [str(TESTS / "workflows"), str(TESTS / "network"), str(TESTS / "recording")]


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Simulated time where no process takes part."""
    if item.path.name == "test_console_choices.py":
        return {"simulated": SimulatedLoop}
    return {"real": asyncio.new_event_loop}
