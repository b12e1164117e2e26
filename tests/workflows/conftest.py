"""The procedure on the simulated cell, with default errors and quick motions."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest
from workflow_bench import WorkflowBench, open_bench

from pcmrs.simulation.loop import SimulatedLoop


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Nobody waits for real."""
    return {"simulated": SimulatedLoop}


@pytest.fixture
async def bench() -> AsyncIterator[WorkflowBench]:
    async with open_bench() as opened:
        yield opened
