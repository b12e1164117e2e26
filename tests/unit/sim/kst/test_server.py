"""The virtual cabinet's port: who is served, who waits, and who is refused."""

import asyncio
from contextlib import suppress

import numpy as np
import pytest

from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError
from pcmrs_sim.cell import CellSimulation, running_cell
from pcmrs_sim.faults import inject
from pcmrs_sim.kst.server import serve_kst
from tests.unit.sim.kst_client import DEADLINE, DONE, KstClient, at_rest, connected, line

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def test_end_ends_the_connection(client: KstClient) -> None:
    client.send("end")
    assert await client.until_closed() == b""


async def test_the_next_client_is_served_after_the_first_has_gone(cell: CellSimulation) -> None:
    async with serve_kst(cell, port=0) as (host, port):
        for _ in range(3):
            async with connected(host, port) as client:
                assert len(await client.joints()) == 7


async def test_an_arm_of_six_joints_has_no_such_cabinet() -> None:
    async with running_cell({"robot": {"driver": "kst", "model": "ur5"}}, SystemClock()) as cell:
        with pytest.raises(ConfigurationError, match="7 joints"):
            async with serve_kst(cell, port=0):
                pass


async def test_the_arm_brakes_when_its_client_goes(cell: CellSimulation) -> None:
    async with serve_kst(cell, port=0) as (host, port):
        async with connected(host, port) as client:
            start = np.array(await client.joints())
            goal = start.copy()
            goal[0] -= 0.5
            await client.ask("jRelVel_0.3_")
            await client.ask(line("jp", goal))
            assert await client.ask("doPTPinJS") == DONE
            while abs((await client.joints())[0] - start[0]) < 0.02:
                await cell.clock.sleep(0.01)
        async with connected(host, port) as client:
            await at_rest(cell)
            assert (await client.joints())[0] > goal[0] + 0.2


async def test_a_second_client_waits_until_the_first_has_gone(cell: CellSimulation) -> None:
    async with serve_kst(cell, port=0) as (host, port), connected(host, port) as first, connected(host, port) as second:
        waiting = asyncio.create_task(second.ask("getJointsPositions"))
        for _ in range(20):
            assert len(await first.joints()) == 7
        assert not waiting.done()
        first.close()
        assert len((await waiting).split(b"_")) == 8


async def test_late_client_is_refused_until_the_application_restarts(cell: CellSimulation) -> None:
    async with serve_kst(cell, port=0, accept_timeout=0.05) as (host, port):
        async with asyncio.timeout(DEADLINE):
            with suppress(ConnectionRefusedError):
                while True:
                    await cell.clock.sleep(0.2)
                    async with connected(host, port):
                        pass
        inject(cell, "restart_cabinet", {})
        async with asyncio.timeout(DEADLINE):
            while True:
                with suppress(ConnectionError):
                    async with connected(host, port) as client:
                        assert len(await client.joints()) == 7
                        break
                await cell.clock.sleep(0.01)
