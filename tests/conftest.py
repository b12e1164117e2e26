"""What holds for every test."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator

import pytest
import structlog
from hypothesis import settings

# How long an example takes says how busy the machine is. `--hypothesis-profile=thorough` tries more of them.
settings.register_profile("pcmrs", deadline=None, max_examples=25)
settings.register_profile("thorough", deadline=None, max_examples=1000)
settings.load_profile("pcmrs")


@pytest.fixture(autouse=True)
def logging_as_it_was() -> Iterator[None]:
    """A command line that ran in this process may have set how it logs."""
    yield
    structlog.reset_defaults()


@pytest.fixture(autouse=True)
async def no_unfinished_tasks() -> AsyncIterator[None]:
    """Fails a test that leaves asyncio tasks behind: they would outlive what they work for."""
    before = asyncio.all_tasks()
    yield
    left = [task for task in asyncio.all_tasks() - before if task is not asyncio.current_task() and not task.done()]
    for task in left:
        task.cancel()
    await asyncio.gather(*left, return_exceptions=True)
    if left:
        pytest.fail(f"{len(left)} unfinished tasks: {', '.join(str(task.get_coro()) for task in left)}")
