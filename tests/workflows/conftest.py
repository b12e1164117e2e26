"""The procedure on the simulated cell, with default errors and quick motions."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
from workflow_bench import WorkflowBench, open_bench


@pytest.fixture
async def bench() -> AsyncIterator[WorkflowBench]:
    async with open_bench() as opened:
        yield opened
