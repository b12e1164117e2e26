"""A UDP link answers to the port that asked, and acknowledges to the reply port."""

from __future__ import annotations

from typing import Any

from tests.unit.gateway.gateway_fakes import UdpClient
from tests.unit.gateway.open_cell import pass_barrier
from tests.unit.gateway.signed_room import Room


async def test_the_mep_link_does_not_reply_and_logs_poses(cell: Any) -> None:
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
