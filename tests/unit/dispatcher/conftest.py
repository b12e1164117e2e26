"""A dispatcher on the bench, closed when the test ends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest

from pcmrs.simulated_time.loop import SimulatedLoop
from tests.unit.dispatcher.dispatcher_fakes import RATMS, Bench


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Simulated time: a busy machine makes no motion too old to begin."""
    return {"simulated": SimulatedLoop}


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    yield made
    await made.dispatcher.close()


@pytest.fixture
async def worldly_bench() -> AsyncIterator[Bench]:
    """Every operation touches the world, so that the steps of each can be made to wait."""
    made = Bench(worldly_branches=RATMS.branches)
    yield made
    await made.dispatcher.close()
