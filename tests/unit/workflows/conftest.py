"""The procedure on the simulated cell, with default errors and quick motions."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.workflows import find_workflow
from tests.support.shipped import unverified_workflow
from tests.unit.workflows.stimulation_bench import StimulationBench, stimulation
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Nobody waits for real."""
    return {"simulated": SimulatedLoop}


@pytest.fixture
async def bench() -> AsyncIterator[WorkflowBench]:
    async with open_bench() as opened:
        yield opened


@pytest.fixture
async def unrevoked(tmp_path: Path) -> AsyncIterator[WorkflowBench]:
    """RATMS as a user may copy it carelessly: a new plan or registration takes no tool from its place."""
    text = find_workflow("ratms").blueprint.read_text().partition("[[properties]]")[0]
    text = text.replace(', revoked_to = { placement = "replanned" }', "")
    revocation = '[[branches.placement.revocations]]\nby = ["registration", "toolplan"]\n'
    head, found, tail = text.partition(revocation)
    assert found
    file = tmp_path / "careless.toml"
    file.write_text(head + tail.partition('to = "held"\n')[2])
    async with open_bench(workflow=unverified_workflow(file)) as opened:
        yield opened


@pytest.fixture
async def armed() -> AsyncIterator[StimulationBench]:
    """Placed, aligned, armed at 50 % below a ceiling of 70 %."""
    async with stimulation() as opened:
        await opened.to_armed()
        yield opened
