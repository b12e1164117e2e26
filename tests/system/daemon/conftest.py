"""One daemon for the tests of a file that leave it alive, and fresh ones for the others."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator

import pytest

from pcmrs.client import Client
from pcmrs.planner import Planner
from tests.system.daemon.daemon_process import ServeProcess, own_settings, running_daemon


@pytest.fixture(scope="module")  # one that idles while other files are tested costs them a third of a core
def shared_daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServeProcess]:
    folder = tmp_path_factory.mktemp("cell")
    with running_daemon(own_settings(folder), folder) as daemon:
        yield daemon


@pytest.fixture
def daemon(shared_daemon: ServeProcess) -> Iterator[ServeProcess]:
    """The shared daemon; fails the test when something went wrong in it."""
    before = len(shared_daemon.log)
    yield shared_daemon
    assert shared_daemon.process.poll() is None
    assert "Traceback" not in shared_daemon.log[before:]


@pytest.fixture
async def planner(daemon: ServeProcess) -> AsyncIterator[Planner]:
    async with daemon.planner() as planner:
        yield planner


@pytest.fixture
async def client(daemon: ServeProcess) -> AsyncIterator[Client]:
    async with daemon.client() as client:
        yield client
