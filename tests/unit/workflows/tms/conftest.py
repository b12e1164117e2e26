"""The workflow `ratms_threshold` with stand-ins for stimulator and electromyograph."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from tests.unit.workflows.stimulation_bench import StimulationBench, stimulation


@pytest.fixture
async def bench() -> AsyncIterator[StimulationBench]:
    """Connected, with nothing registered."""
    async with stimulation() as opened:
        yield opened
