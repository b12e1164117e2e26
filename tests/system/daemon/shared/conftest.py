"""One daemon for all files of this folder; each test gets it in its initial state."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator

import pytest

from pcmrs.client import Client
from pcmrs.planner import Planner
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.driving import reset_cell
from tests.system.daemon.daemon_process import ServeProcess, own_settings, running_daemon


@pytest.fixture(scope="package")
def shared_daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServeProcess]:
    folder = tmp_path_factory.mktemp("cell")
    with running_daemon([*own_settings(folder), *LIGHT], folder) as daemon:
        yield daemon


@pytest.fixture
async def daemon(shared_daemon: ServeProcess) -> AsyncIterator[ServeProcess]:
    """The shared daemon, reset; fails the test when something went wrong in it."""
    async with shared_daemon.client() as client:
        await reset_cell(client)
    shared_daemon.forget_log()
    yield shared_daemon
    assert shared_daemon.process.poll() is None
    assert "Traceback" not in shared_daemon.log


@pytest.fixture
async def planner(daemon: ServeProcess) -> AsyncIterator[Planner]:
    async with daemon.planner() as planner:
        yield planner


@pytest.fixture
async def client(daemon: ServeProcess) -> AsyncIterator[Client]:
    async with daemon.client() as client:
        yield client
