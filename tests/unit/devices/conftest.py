"""What tests of drivers share."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Iterator, Mapping
from typing import cast

import pytest

from pcmrs.devices.kst import drive

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
