"""The gateway as a whole: its clients, its ports, its closing, and the replies of its links over UDP."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.gateway import links
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.settings import GatewayConfig, LinkConfig
from pcmrs.testing.clock import settle
from tests.unit.gateway.gateway_fakes import POSE, FakeCore, ManualClock, UdpClient
from tests.unit.gateway.open_cell import pass_barrier
from tests.unit.gateway.signed_room import Room, peer, signer


async def test_an_unmodified_client_plans_landmarks_and_registers(cell: Any) -> None:
    cell.core.results["register"] = {"residual": 0.002300912, "rms": 0.0025}
    await cell.tell("img_fid_numxxxxx_02;")
    await cell.tell("img_fid_pntxxxxx_01_0.400000000000000_0.5_0.6;")
    await cell.tell("img_fid_pntxxxxx_00_0.100000000000000_0.2_0.3;")
    await cell.tell("img_fid_lastrecv;")
    await cell.tell("start_autodigitz;")
    assert await cell.tell("start_registrati;") == "ack"
    assert await cell.replies.received.get() == "2.300912"
    assert cell.core.operations == ["plan_landmarks", "digitize_all", "register"]
    assert cell.core.commands[0].arguments["landmarks"] == [
        {"name": "p0", "position": [0.1, 0.2, 0.3]},
        {"name": "p1", "position": [0.4, 0.5, 0.6]},
    ]


async def test_a_refused_registration_returns_no_number(cell: Any) -> None:
    cell.core.refusals["register"] = "residual_too_large"
    assert await cell.tell("start_registrati;") == "ack"
    assert await cell.replies.received.get() == "no_data_returned;"


async def test_a_stop_that_is_not_confirmed_is_no_success(cell: Any) -> None:
    cell.core.stands = False
    assert await cell.ask("stop_now_xxxxxxx_#9;", cell.robot) == "9_failed_robot_1_hold_not_confirmed;"


async def test_refinement_is_acknowledged_without_a_second_datagram(cell: Any) -> None:
    assert await cell.tell("icp_registerxxxx_/m/a_b.stl;") == "ack"
    await pass_barrier(cell)
    assert cell.replies.received.empty()


async def test_refused_refinement_is_answered_with_its_reason(cell: Any) -> None:
    cell.core.refusals["refine"] = "unknown_surface"
    assert await cell.ask("icp_registerxxxx_/m/no.stl_#1;") == "1_rejected_registration_000_unknown_surface;"


async def test_a_daemon_that_breaks_is_answered_for(cell: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(command: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(cell.core, "submit", broken)
    assert await cell.ask("rob_conn_onxxxxx_#1;") == "1_failed_robot_1_internal_error;"


async def test_tool_points_from_mixed_reality_reach_the_planner(cell: Any) -> None:
    cell.client.send("__msg_toolpose_1_2_3_4_5_6.5", cell.planner)
    assert await cell.stream.received.get() == "__msg_toolpose_1.00000_2.00000_3.00000_4.00000_5.00000_6.50000"


async def test_each_link_has_its_own_address_and_rule(cell: Any, tmp_path: Path) -> None:
    """127.0.0.1 stands for this machine, and every address for a network."""
    config = GatewayConfig(
        planner=LinkConfig(port=0),
        robot=LinkConfig(),
        visualization=LinkConfig(),
        mep=LinkConfig(host="0.0.0.0", port=0),
        tcp_host="0.0.0.0",
        tcp_port=0,
        peers={"mep": peer(tmp_path, "mep")},
    )
    async with open_gateway(cell.core, config, cell.clock, tmp_path) as gateway:
        hosts = {name: host for name, (host, _) in gateway.addresses.items()}
        assert hosts == {"planner": "127.0.0.1", "mep": "0.0.0.0", "tcp": "0.0.0.0"}
        exposed = ("127.0.0.1", gateway.addresses["mep"][1])
        cell.client.send("get_jnt_angsxxxx_#1;", exposed)
        cell.client.send(signer(tmp_path, "mep").sign(b"get_jnt_angsxxxx_#2;"), exposed)
        assert (await cell.client.received.get()).startswith("2_accepted")
        cell.client.send("get_jnt_angsxxxx_#3;", gateway.addresses["planner"])
        assert (await cell.client.received.get()).startswith("3_accepted")
        assert gateway.counters.refused == 1


async def test_port_in_use_is_an_error(cell: Any, tmp_path: Path) -> None:
    config = GatewayConfig(planner=LinkConfig(port=cell.planner[1]))
    with pytest.raises(ConfigurationError, match="cannot be bound"):
        async with open_gateway(FakeCore(), config, ManualClock(), tmp_path):
            pass


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


async def test_closing_tells_clients_what_became_of_their_commands(cell: Any, tmp_path: Any) -> None:
    for name in ("approach", "register"):
        cell.core.gates[name].clear()
    async with links.open_gateway(cell.core, cell.config, cell.clock, tmp_path) as gateway:
        cell.client.send("execute_motionxx_#1;", gateway.addresses["planner"])
        cell.client.send("start_registrati;", gateway.addresses["planner"])
        reader, writer = await asyncio.open_connection(*gateway.addresses["tcp"])
        writer.write(b"execute_motionxx_#2;")
        while len(cell.core.commands) < 3:
            cell.core.arrived.clear()
            await cell.core.arrived.wait()
        cell.core.refusals = {"approach": "stopped", "register": "stopped"}
        cell.core.open_gates()  # as Dispatcher.close does; nothing has been sent yet when the gateway begins to close
    assert await cell.client.received.get() == "1_rejected_placement_retracted_stopped;"
    assert [await cell.replies.received.get() for _ in range(2)] == ["ack", "no_data_returned;"]
    assert await reader.read() == b"2_rejected_placement_retracted_stopped;"
    writer.close()


async def test_closing_does_not_wait_for_ever(cell: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    cell.core.gates["approach"].clear()
    async with links.open_gateway(cell.core, cell.config, cell.clock, tmp_path) as gateway:
        cell.client.send("execute_motionxx_#1;", gateway.addresses["planner"])
        await cell.core.arrived.wait()
        waits: list[float] = []

        def expired(seconds: float) -> asyncio.Timeout:
            waits.append(seconds)
            return asyncio.timeout(0.0)

        monkeypatch.setattr(cell.clock, "timeout", expired)
    assert waits == [links.FINISH_WITHIN]
    assert cell.client.received.empty()


async def test_the_mep_link_does_not_reply_and_logs_poses(cell: Any) -> None:
    cell.core.registered = POSE
    cell.client.send("save_planandreal;", cell.mep)
    await pass_barrier(cell, cell.mep)
    assert cell.replies.received.empty()
    assert (await cell.ask("save_continupose_#1;")).endswith("_busy;")


async def test_a_client_without_verdicts_is_acknowledged_as_ever(room: Room) -> None:
    room.core.results["register"] = {"residual": 0.0021}
    room.client.send(room.sign("start_registrati;"), room.planner)
    assert await room.replies.received.get() == "ack"
    assert await room.replies.received.get() == "2.100000"


async def test_a_peer_stays_itself_when_its_port_changes(room: Room) -> None:
    await room.ask("target_rotxxxxxx_0_0_0_1_#1;")
    other = await UdpClient.open()
    other.send(room.sign("target_tslxxxxxx_0.1_0_0_#2;"), room.planner)
    assert (await other.received.get()).startswith("2_accepted")
    other.send(room.sign("target_tslxxxxxx_0.1_0_0_#2;"), room.planner)  # the same command anew: its id is known
    assert (await other.received.get()).startswith("2_accepted")
    assert room.core.operations == ["plan"]
    assert {command.source for command in room.core.commands} == {"peer:planner"}
    other.transport.close()


async def test_no_text_ends_the_receiver(cell: Any) -> None:
    for text in ("close", "close;", "quit", "exit;", "shutdown", "\x03"):
        cell.client.send(text, cell.planner)
    assert (await cell.ask("stop_visualizexx_#1;")).startswith("1_accepted")
