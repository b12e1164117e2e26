"""A dispatcher on the bench, closed when the test ends."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
from dispatcher_fakes import RATMS, Bench


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
