"""A dispatcher on the bench, closed when the test ends."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
from dispatcher_fakes import Bench


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    yield made
    await made.dispatcher.close()
