"""Fixtures that tests of devices share."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from typing import TYPE_CHECKING, cast

import pytest
import pytest_asyncio

from pcmrs.devices.kst import drive
from tests.unit.devices.node_bench import Bench, open_bench

if TYPE_CHECKING:
    from tests.unit.devices import contract_robots

REAL_TIME: Mapping[str, Callable[[], asyncio.AbstractEventLoop]] = {"real": asyncio.new_event_loop}


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> Mapping[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Event loops as a test module names them in `LOOPS`: simulated time if neither process nor socket takes part."""
    return getattr(cast(pytest.Function, item).module, "LOOPS", REAL_TIME)


def pytest_itemcollected(item: pytest.Item) -> None:
    """Leave to the nightly run what a module runs on the loops that it names in `NIGHTLY_LOOPS`."""
    nightly = getattr(getattr(item, "module", None), "NIGHTLY_LOOPS", ())
    if any(name in re.split(r"[\[\]-]", item.name) for name in nightly):
        item.add_marker(pytest.mark.nightly)


@pytest.fixture(scope="module")
def patient() -> Iterator[None]:
    """A test machine may leave this process alone for a while; what a stream does then has a test of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drive, "STALLED", 10.0)
        yield


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    """A device node with fakes of its devices, in simulated time."""
    async with open_bench() as opened:
        yield opened


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def opened() -> AsyncIterator[contract_robots.Bench]:
    """One cell for all tests of a module in which dynamics do not matter: each ends the faults that it begins."""
    from tests.unit.devices.contract_robots import bench  # here, because without MuJoCo it skips its importer

    async with bench() as opened:
        yield opened


@pytest_asyncio.fixture(loop_scope="module")
async def lab(opened: contract_robots.Bench) -> contract_robots.Bench:
    """The cell of the module, with its arm at the home position."""
    await opened.back_home()
    return opened
