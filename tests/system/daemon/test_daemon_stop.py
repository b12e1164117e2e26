"""Stop from every edge of the daemon while the arm moves. By a page: `system/console/test_browser.py`."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from pcmrs.client import Client
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.driving import accept, moving, register
from tests.system.daemon.daemon_process import (
    SLOW,
    ServeProcess,
    own_settings,
    running_daemon,
    stands_still,
    virtual_drivers,
)

Stop = Callable[[ServeProcess, Client], Awaitable[None]]


async def stop_by_udp(daemon: ServeProcess, client: Client) -> None:
    async with daemon.planner() as planner:
        await planner.stop()


async def stop_by_tcp(daemon: ServeProcess, client: Client) -> None:
    reader, writer = await asyncio.open_connection(*daemon.ready.links["tcp"])
    writer.write(b"stop_now_xxxxxxx;")
    assert await reader.readuntil(b";"), "it was acknowledged"
    writer.close()


async def stop_by_query(daemon: ServeProcess, client: Client) -> None:
    await client.stop()


async def stop_by_put(daemon: ServeProcess, client: Client) -> None:
    with daemon.plain_session() as session:
        session.put(f"{daemon.ready.prefix}/stop/nurse", "now")


async def stop_by_command_line(daemon: ServeProcess, client: Client) -> None:
    ended = daemon.pcmrs("stop")
    assert ended.returncode == 0, ended.stderr


def simulated_drivers() -> list[str]:
    """Settings of an arm without dynamics: how they stop is tested without a daemon, and each night with one."""
    return [*LIGHT, "cell.rate=1"]  # a motion lasts longer than the command line takes to start on a busy machine


@pytest.mark.parametrize("drivers", [simulated_drivers, pytest.param(virtual_drivers, marks=pytest.mark.nightly)])
async def test_stop_from_every_edge_holds_a_moving_arm_and_latches(
    tmp_path: Path, drivers: Callable[[], list[str]]
) -> None:
    with running_daemon([*own_settings(tmp_path), *SLOW, *drivers()], tmp_path) as daemon:
        async with daemon.client() as client:
            for stop in (stop_by_udp, stop_by_tcp, stop_by_query, stop_by_put, stop_by_command_line):
                await _stop_and_recover(daemon, client, stop)
        assert "Traceback" not in daemon.log


async def _stop_and_recover(daemon: ServeProcess, client: Client, stop: Stop) -> None:
    await register(client)
    async with moving(client) as approach:
        await stop(daemon, client)
        verdict = await approach
    assert verdict.decision == "failed"
    assert verdict.state == "held"
    # The node hears Stop by itself too, and may have ended the motion first.
    assert verdict.reason is not None
    assert verdict.reason.code in ("stopped", "motion_stopped")
    assert await stands_still(client)
    assert (await client.state()).latched
    refused = await client.call("placement.back_off")
    assert refused.decision == "rejected"
    assert refused.reason is not None
    assert refused.reason.code == "latched"
    await accept(client, "robot.acknowledge")
    await accept(client, "placement.back_off")
    assert (await client.state()).branches["placement"] == "retracted"
