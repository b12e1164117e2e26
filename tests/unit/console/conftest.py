"""Tests of the page without processes run in simulated time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from pcmrs.simulated_time.loop import SimulatedLoop
from tests.unit.console.detached_page import page


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Simulated time where no process takes part."""
    if item.path.name in ("test_choices.py", "test_live_feed.py"):
        return {"simulated": SimulatedLoop}
    return {"real": asyncio.new_event_loop}


__all__ = ["page", "pytest_asyncio_loop_factories"]
