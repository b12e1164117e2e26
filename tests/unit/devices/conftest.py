"""What tests of drivers share."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import cast

import pytest

from pcmrs.devices.kst import drive

REAL_TIME: Mapping[str, Callable[[], asyncio.AbstractEventLoop]] = {"real": asyncio.new_event_loop}


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> Mapping[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Event loops as a test module names them in `LOOPS`: simulated time if neither process nor socket takes part."""
    return getattr(cast(pytest.Function, item).module, "LOOPS", REAL_TIME)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A test machine may leave this process alone for a while; what a stream does then has a test of its own."""
    monkeypatch.setattr(drive, "STALLED", 10.0)
