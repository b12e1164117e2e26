"""What holds for every test."""

from __future__ import annotations

import asyncio
import gc
import signal
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
import structlog
from hypothesis import settings

from tests import TESTS
from tests.support import quick
from tests.support.skip_budget import OPTION, SkipBudget
from tests.support.trials import USUAL

# A shell may ignore Ctrl-C for what it runs, as scripts do for what they start with `&`. Children inherit that, and
# would not end by the signal that tests send them.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# How long an example takes says how busy the machine is. `make nightly` tries properties with the profile `nightly`,
# `--hypothesis-profile=thorough` tries more; both scale what `trials.examples` says.
settings.register_profile("pcmrs", deadline=None, max_examples=USUAL)
settings.register_profile("nightly", deadline=None, max_examples=100)
settings.register_profile("thorough", deadline=None, max_examples=1000)
settings.load_profile("pcmrs")


# By default, structlog draws a traceback with Rich, which takes a quarter of a second.
RENDERER = structlog.dev.ConsoleRenderer(exception_formatter=structlog.dev.plain_traceback)
PROCESSORS = [*structlog.get_config()["processors"][:-1], RENDERER]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        OPTION, action="store_true", help="fail when a test is skipped that tests/support/skips.toml does not name"
    )
    quick.add_options(parser)


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption(OPTION):
        config.pluginmanager.register(SkipBudget(), "skip-budget")
    if (costs := config.getoption(quick.COSTS)) is not None:
        config.pluginmanager.register(quick.Costs(Path(costs).absolute()), "costs")


class Collected(NamedTuple):
    """A test that was collected; a parametrized one is there once for each instance.

    Attributes:
        file: Below ``tests``.
        only: Marker that keeps it out of ``make test``: ``nightly`` or ``browser``; empty if it is in it.
    """

    file: str
    name: str
    only: str


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collects without garbage collection: what is collected stays, and it is most of what the process has."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


COLLECTED = pytest.StashKey[list[Collected]]()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Notes tests before those are left out that `-m` does not select."""
    config.stash[COLLECTED] = [
        Collected(
            item.path.relative_to(TESTS).as_posix(),
            item.name.partition("[")[0],
            next((marker for marker in ("nightly", "browser") if item.get_closest_marker(marker)), ""),
        )
        for item in items
    ]
    if config.getoption(quick.QUICK):
        quick.leave_out_slow(config, items)


@pytest.fixture
def collected(request: pytest.FixtureRequest) -> list[Collected]:
    """Tests of all files that this run has collected, nightly ones included."""
    return request.config.stash[COLLECTED]


@pytest.fixture(autouse=True)
def plain_logging() -> Iterator[None]:
    """Logs as by default, but with plain tracebacks, whatever a command line that ran in this process has set."""
    structlog.configure(processors=PROCESSORS)
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
