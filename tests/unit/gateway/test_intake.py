"""Intake of all links: senders, counts, and repeated ids, however much was forgotten in between."""

from __future__ import annotations

import asyncio
import gc
from pathlib import Path
from typing import Any, Literal

import pytest

from pcmrs.dispatcher import verdict_cache
from pcmrs.dispatcher.verdict_cache import CommandCache
from pcmrs.gateway import intake, peer_session
from pcmrs.gateway.grammar import CommandOutcome
from pcmrs.gateway.intake import Intake, source_of
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.settings import GatewayConfig, LinkConfig
from tests.unit.gateway.gateway_fakes import WITHIN, FakeCore, ManualClock, UdpClient
from tests.unit.gateway.open_cell import hear_from_others, pass_barrier


@pytest.fixture
def sessions_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(intake, "MAX_SESSIONS", 1)


@pytest.fixture
def outcomes_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict_cache, "MAX_REMEMBERED", 1)


async def hear_from_another(cell: Any) -> None:
    """Another peer's command; the peer_session and the outcomes of the first are no longer the newest."""
    other = await UdpClient.open()
    await other.ask("get_jnt_angsxxxx_#1;", cell.planner)
    other.transport.close()


class Refusals(asyncio.Semaphore):
    """Released once for every refusal, which by design nobody is told of; `acquire` fails when none comes."""

    async def acquire(self) -> Literal[True]:
        async with asyncio.timeout(WITHIN):
            return await super().acquire()


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> Refusals:
    semaphore, refuse = Refusals(0), Intake.refuse

    def refuse_and_tell(*args: Any) -> None:
        refuse(*args)
        semaphore.release()

    monkeypatch.setattr(Intake, "refuse", refuse_and_tell)
    return semaphore


@pytest.mark.usefixtures("sessions_are_forgotten")
@pytest.mark.parametrize("refused_by_gateway", [True, False])
async def test_the_verdict_outlives_the_session(cell: Any, refused_by_gateway: bool) -> None:
    if refused_by_gateway:
        await cell.ask("target_rotxxxxxx_0_0_0_1_#1;")
    first = await cell.ask("execute_motionxx_#2;")
    ran = list(cell.core.operations)
    await cell.ask("target_rotxxxxxx_0_0_0_1_#3;")
    await cell.ask("target_tslxxxxxx_0_0_0_#4;")
    await hear_from_another(cell)
    assert await cell.ask("execute_motionxx_#2;") == first
    assert cell.core.operations == [*ran, "plan"]


@pytest.mark.usefixtures("sessions_are_forgotten", "outcomes_are_forgotten")
async def test_the_daemon_recognises_what_the_gateway_forgot(cell: Any) -> None:
    first = await cell.ask("execute_motionxx_#1;")
    await hear_from_another(cell)
    assert await cell.ask("execute_motionxx_#1;") == first
    assert cell.core.operations == ["approach"]


@pytest.mark.usefixtures("sessions_are_forgotten", "outcomes_are_forgotten")
@pytest.mark.parametrize(("before", "after"), [("retracted", "placed"), ("placed", "retracted")])
async def test_forgotten_command_that_would_now_differ_runs_nothing(cell: Any, before: str, after: str) -> None:
    cell.core.branches["placement"] = before
    assert (await cell.ask("end_session_back_#1;")).startswith("1_accepted")
    ran = list(cell.core.operations)
    await hear_from_another(cell)
    cell.core.branches["placement"] = after
    assert (await cell.ask("end_session_back_#1;")).endswith("_id_reused;")
    assert cell.core.operations == ran


async def test_ids_are_forgotten_at_each_opening(cell: Any, tmp_path: Any) -> None:
    async with open_gateway(cell.core, cell.config, cell.clock, tmp_path) as gateway:
        await cell.ask("rob_conn_onxxxxx_#1;", gateway.addresses["planner"])
    await cell.ask("rob_conn_onxxxxx_#1;")
    assert cell.core.operations == ["connect", "connect"]


@pytest.mark.usefixtures("outcomes_are_forgotten")
async def test_a_command_under_way_is_not_forgotten() -> None:
    remembered: CommandCache[asyncio.Future[CommandOutcome]] = CommandCache()
    loop = asyncio.get_running_loop()
    running, done = loop.create_future(), loop.create_future()
    done.set_result(CommandOutcome("accepted", "robot", "1"))
    remembered.put("a", "1", running)
    remembered.put("a", "2", done)
    remembered.put("a", "3", done)
    assert remembered.get("a", "1") is running
    assert remembered.get("a", "2") is None


async def test_so_many_sessions_are_kept(cell: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    gc.collect()
    before = {id(each) for each in gc.get_objects() if isinstance(each, peer_session.PeerSession)}
    monkeypatch.setattr(intake, "MAX_SESSIONS", 3)
    await hear_from_others(cell, 10)
    gc.collect()
    kept = [each for each in gc.get_objects() if isinstance(each, peer_session.PeerSession) and id(each) not in before]
    assert len(kept) == 3


@pytest.mark.parametrize(
    ("link", "source"),
    [
        ("planner", "udp:planner:127.0.0.1:5000"),
        ("robot", "udp:robot:127.0.0.1:5000"),
        ("tcp", "tcp:127.0.0.1:5000"),
        ("openigtlink", "openigtlink:127.0.0.1:5000"),
    ],
)
def test_a_source_is_named_by_its_link_and_address(link: str, source: str) -> None:
    assert source_of(link, ("127.0.0.1", 5000)) == source


async def test_the_same_id_of_another_peer_is_another_command(cell: Any) -> None:
    other = await UdpClient.open()
    await cell.ask("rob_conn_onxxxxx_#1;")
    await other.ask("rob_conn_onxxxxx_#1;", cell.planner)
    assert len({(command.source, command.id) for command in cell.core.commands}) == 2
    other.transport.close()


async def test_bad_datagrams_are_counted_and_change_nothing(cell: Any) -> None:
    bad = [
        b"\xff" * 20,
        b"x" * 5000,
        b"execute_motionxx",
        b"close_the_socket;",
        b"execute_motionxx;|a|1|" + b"0" * 32,
    ]
    for data in bad:
        cell.client.send(data, cell.planner)
    await pass_barrier(cell)
    assert cell.gateway.counters.refused == len(bad)
    assert cell.core.events[0].fields["source"] == f"udp:planner:127.0.0.1:{cell.client.port}"
    assert cell.core.commands == []
    assert cell.client.received.empty()
    assert cell.replies.received.empty()


async def test_refusal_by_the_gateway_is_reported_with_its_reason(cell: Any) -> None:
    assert (await cell.ask("target_tslxxxxxx_0_0_0.1_#5;")).endswith("_no_rotation;")
    (event,) = cell.core.events
    assert event.fields == {"count": 1, "source": f"udp:planner:127.0.0.1:{cell.client.port}", "reason": "no_rotation"}


async def test_a_link_that_is_not_on_loopback_refuses_everything(tmp_path: Path, refused: Refusals) -> None:
    core, replies = FakeCore(), await UdpClient.open()
    config = GatewayConfig(
        host="0.0.0.0",
        planner=LinkConfig(port=0, reply_port=replies.port),
        robot=LinkConfig(),
        visualization=LinkConfig(),
        mep=LinkConfig(),
        tcp_port=0,
    )
    async with open_gateway(core, config, ManualClock(), tmp_path) as gateway:
        replies.send("stop_now_xxxxxxx;", ("127.0.0.1", gateway.addresses["planner"][1]))
        _, writer = await asyncio.open_connection("127.0.0.1", gateway.addresses["tcp"][1])
        writer.write(b"stop_now_xxxxxxx;")
        await refused.acquire()
        await refused.acquire()
        writer.close()
    assert core.stops == []
    assert replies.received.empty()
    replies.transport.close()


async def test_a_loopback_peer_that_is_not_listed_is_refused(tmp_path: Path, refused: Refusals) -> None:
    core, client = FakeCore(), await UdpClient.open()
    config = GatewayConfig(
        planner=LinkConfig(port=0),
        robot=LinkConfig(),
        visualization=LinkConfig(),
        mep=LinkConfig(),
        tcp_port=None,
        unsigned_peers=("127.0.0.9",),
    )
    async with open_gateway(core, config, ManualClock(), tmp_path) as gateway:
        client.send("stop_now_xxxxxxx;", gateway.addresses["planner"])
        await refused.acquire()
    assert core.stops == []
    client.transport.close()
