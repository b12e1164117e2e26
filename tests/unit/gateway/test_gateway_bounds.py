"""What no client may do: go unheard, flood, or come from where a name leads."""

from __future__ import annotations

import asyncio
import gc
import math
from typing import Any

import pytest
from structlog.testing import capture_logs

from pcmrs.errors import ConfigurationError
from pcmrs.gateway import intake, links, peer_session
from pcmrs.gateway.peer_session import SECOND_WITHIN
from pcmrs.gateway.settings import GatewayConfig
from pcmrs.hosts import is_loopback
from pcmrs.testing.clock import settle
from tests.unit.gateway.gateway_fakes import WITHIN, UdpClient


async def test_refusal_to_a_client_without_verdicts_is_logged(cell: Any) -> None:
    cell.core.refusals["approach"] = "not_registered"
    with capture_logs() as logged:
        await cell.tell("execute_motionxx;")
        await cell.tell("start_registrati;")
        await cell.replies.received.get()  # the second command has ended, and so has the first
    (refused,) = (line for line in logged if line["event"] == "command_refused")
    assert (refused["command"], refused["decision"], refused["reason"]) == (
        "execute_motionxx", "rejected", "not_registered",
    )  # fmt: skip


async def test_refusal_later_than_clients_wait_is_logged(cell: Any) -> None:
    cell.core.refusals["register"] = "residual_too_large"
    cell.core.gates["register"].clear()
    with capture_logs() as logged:
        await cell.tell("start_registrati;")
        async with asyncio.timeout(WITHIN):
            await cell.core.arrived.wait()
        cell.clock.expire(SECOND_WITHIN)
        assert await cell.replies.received.get() == "no_data_returned;"
        cell.core.gates["register"].set()
        await cell.tell("start_useprevreg;")
        await cell.replies.received.get()  # the second command has ended, and so has the first
    assert [(line["event"], line.get("reason")) for line in logged] == [("command_refused", "residual_too_large")]


async def test_a_refusal_makes_up_for_no_plan(cell: Any) -> None:
    await cell.ask("img_fid_numxxxxx_02_#1;")
    cell.core.refusals["use_previous"] = "other_patient"
    assert (await cell.ask("start_useprevreg_#2;")).endswith("_other_patient;")
    assert (await cell.ask("execute_motionxx_#3;")).endswith("plan_not_accepted;")


async def test_only_what_waits_or_runs_fills_a_queue(cell: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peer_session, "MAX_WAITING", 2)
    for number in range(5):
        assert (await cell.ask(f"rob_conn_onxxxxx_#{number};")).startswith(f"{number}_accepted")


async def hear_from_others(cell: Any, many: int) -> None:
    for _ in range(many):
        other = await UdpClient.open()
        await other.ask("get_jnt_angsxxxx_#1;", cell.planner)
        other.transport.close()


async def test_so_many_sessions_are_kept(cell: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    gc.collect()
    before = {id(each) for each in gc.get_objects() if isinstance(each, peer_session.PeerSession)}
    monkeypatch.setattr(intake, "MAX_SESSIONS", 3)
    await hear_from_others(cell, 10)
    gc.collect()
    kept = [each for each in gc.get_objects() if isinstance(each, peer_session.PeerSession) and id(each) not in before]
    assert len(kept) == 3


@pytest.mark.parametrize("queued", ["start_autodigitz; start_registrati;", "end_session_back;"])
async def test_stop_reaches_a_client_however_many_came_after_it(
    cell: Any, monkeypatch: pytest.MonkeyPatch, queued: str
) -> None:
    """What waits, or has steps to come, is not idle: its session is not forgotten."""
    monkeypatch.setattr(intake, "MAX_SESSIONS", 1)
    for name in ("digitize_all", "to_initial"):
        cell.core.gates[name].clear()
    for command in queued.split():
        await cell.tell(command)
    await hear_from_others(cell, 2)
    ran = list(cell.core.operations)
    assert len(ran) == 1
    await cell.core.stop("device:robot")
    cell.core.open_gates()
    await settle()
    assert cell.core.operations == ran


async def test_a_command_takes_no_step_after_the_gateway_was_closed(
    cell: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.core.gates["to_initial"].clear()
    async with links.open_gateway(cell.core, cell.config, cell.clock, tmp_path) as gateway:
        cell.client.send("end_session_back_#1;", gateway.addresses["planner"])
        await cell.core.arrived.wait()
        monkeypatch.setattr(cell.clock, "timeout", lambda _: asyncio.timeout(0.0))
    cell.core.open_gates()
    await settle()
    assert cell.core.operations == ["to_initial"]


async def test_a_tcp_client_that_does_not_read_is_read_from_no_more(cell: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    room = asyncio.Event()

    async def drain(_writer: asyncio.StreamWriter) -> None:
        await room.wait()

    monkeypatch.setattr(asyncio.StreamWriter, "drain", drain)
    reader, writer = await asyncio.open_connection(*cell.gateway.addresses["tcp"])
    writer.write(b"get_jnt_angsxxxx_#1;get_jnt_angsxxxx_#2;")
    assert (await reader.readuntil(b";")).startswith(b"1_accepted")
    await settle()
    assert cell.gateway.counters.received == 1
    room.set()
    assert (await reader.readuntil(b";")).startswith(b"2_accepted")
    writer.close()


@pytest.mark.parametrize("host", ["localhost", "planner.local", "127.0.0.1.example.org", "", "192.0.2.1", "::2"])
def test_a_name_is_never_taken_for_this_machine(host: str) -> None:
    """Somebody else may say where it leads."""
    assert not is_loopback(host)
    with pytest.raises(ConfigurationError, match="loopback"):
        GatewayConfig(unsigned_peers=(host,))


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_stream_has_a_rate(rate: float) -> None:
    with pytest.raises(ConfigurationError, match="greater than 0"):
        GatewayConfig(stream_rate_hz=rate)
