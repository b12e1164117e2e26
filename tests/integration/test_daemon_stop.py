"""Stop from every edge while the arm moves."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable

import pytest
from daemon_process import ServeProcess
from driving import approaching, recover, stands_still

from pcmrs.client import Client

Stop = Callable[[ServeProcess, Client], Awaitable[None]]


async def stop_by_udp(daemon: ServeProcess, client: Client) -> None:
    async with daemon.planner() as planner:
        await planner.stop()


async def stop_by_query(daemon: ServeProcess, client: Client) -> None:
    await client.stop()


async def stop_by_put(daemon: ServeProcess, client: Client) -> None:
    with daemon.plain_session() as session:
        session.put(f"{daemon.ready.prefix}/stop/nurse", "now")


async def stop_by_command_line(daemon: ServeProcess, client: Client) -> None:
    ended = daemon.pcmrs("stop")
    assert ended.returncode == 0, ended.stderr


@pytest.fixture
async def slow_client(slow_daemon: ServeProcess) -> AsyncIterator[Client]:
    async with slow_daemon.client() as client:
        yield client


@pytest.mark.parametrize("stop", [stop_by_udp, stop_by_query, stop_by_put, stop_by_command_line])
async def test_stop_holds_a_moving_arm_and_latches(slow_daemon: ServeProcess, slow_client: Client, stop: Stop) -> None:
    async with approaching(slow_daemon, slow_client) as approach:
        await stop(slow_daemon, slow_client)
        verdict = await approach
    assert verdict.decision == "failed"
    assert verdict.state == "held"
    # The node hears Stop by itself too, and may have ended the motion first.
    assert verdict.reason is not None
    assert verdict.reason.code in ("stopped", "motion_stopped")
    assert await stands_still(slow_client)
    assert (await slow_client.state()).latched
    refused = await slow_client.call("placement.back_off")
    assert refused.decision == "rejected"
    assert refused.reason is not None
    assert refused.reason.code == "latched"
    await recover(slow_client)
    assert (await slow_client.state()).branches["placement"] == "retracted"
