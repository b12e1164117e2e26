"""A running cell for each file, and a client of its virtual cabinet for each test."""

from collections.abc import AsyncIterator

import pytest_asyncio

from pcmrs.clock import SystemClock
from pcmrs_sim.cell import CellSimulation, running_cell
from tests.unit.sim.kst_client import KstClient, at_rest, client_of


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def cell() -> AsyncIterator[CellSimulation]:
    async with running_cell({"robot": {"driver": "kst"}}, SystemClock()) as cell:
        yield cell


@pytest_asyncio.fixture(loop_scope="module")
async def client(cell: CellSimulation) -> AsyncIterator[KstClient]:
    await at_rest(cell)
    async with client_of(cell) as client:
        yield client
