"""Stop that comes another way than by the peer whose commands it ends."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.gateway import links
from pcmrs.gateway.intake import Intake


async def test_commands_queued_before_a_stop_from_elsewhere_never_run(cell: Any) -> None:
    cell.core.gates["digitize_all"].clear()
    for command in ("start_autodigitz", "execute_motionxx", "start_registrati"):
        assert await cell.tell(f"{command};") == "ack"
    await cell.core.stop("bus:operator")
    assert await cell.replies.received.get() == "no_data_returned;"
    cell.core.open_gates()
    await cell.tell("rob_conn_onxxxxx;")  # sent after the stop, so it runs, and behind all of the others
    while "connect" not in cell.core.operations:
        cell.core.arrived.clear()
        await cell.core.arrived.wait()
    assert cell.core.operations == ["digitize_all", "connect"]


async def test_commands_received_just_before_a_stop_never_start(cell: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """They came in the same turn of the loop."""
    receive = Intake.receive

    def receive_and_stop(intake: Intake, *datagram: Any) -> Any:
        received = receive(intake, *datagram)
        intake.on_stop()  # nothing that came has begun yet
        return received

    with monkeypatch.context() as patch:
        patch.setattr(Intake, "receive", receive_and_stop)
        assert await cell.ask("execute_motionxx_#1;") == "1_rejected_placement_retracted_stopped;"
        assert (await cell.ask("stop_now_xxxxxxx_#2;")).startswith("2_accepted"), "Stop itself is never too late"
    assert cell.core.operations == []
    assert (await cell.ask("execute_motionxx_#3;")).startswith("3_accepted")
    assert cell.core.operations == ["approach"]


@pytest.mark.parametrize(
    ("command", "first", "reply"),
    [
        ("end_session_back", "back_off", "1_failed_toolplan_0_stopped;"),
        ("session_reinitxx", "reinit", "1_failed_toolplan_0_stopped;"),
        ("img_dig_digitize_03", "redigitize_one", "1_failed_digitization_1_stopped;"),
    ],
)
async def test_after_a_stop_a_command_takes_no_further_step(cell: Any, command: str, first: str, reply: str) -> None:
    cell.core.branches |= {"placement": "placed", "digitization": "1"}
    cell.core.gates[first].clear()
    cell.client.send(f"{command}_#1;", cell.planner)
    await cell.core.arrived.wait()
    await cell.core.stop("device:robot")
    cell.core.open_gates()  # the step under way ended well before Stop could reach it
    assert await cell.client.received.get() == reply
    assert cell.core.operations == [first]
    assert await cell.ask(f"{command}_#1;") == reply
    assert cell.core.operations == [first]


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


async def test_stop_is_honoured_every_time_whatever_its_id(cell: Any) -> None:
    for _ in range(3):
        assert (await cell.ask("stop_now_xxxxxxx_#7;")).startswith("7_accepted_robot")
    assert len(cell.core.stops) == 3


async def test_stop_passes_what_it_would_have_to_wait_for(cell: Any) -> None:
    cell.core.gates["digitize_all"].clear()
    for command in ("start_autodigitz", "stop_now_xxxxxxx"):
        assert await cell.tell(f"{command};") == "ack"
    assert (await cell.ask("get_jnt_angsxxxx_#900;")).startswith("900_accepted")  # everything before has arrived

    assert len(cell.core.stops) == 1
    cell.core.open_gates()
