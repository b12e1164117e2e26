"""Sessions: order, acknowledgements, Stop, motions that never queue, and bounds."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from structlog.testing import capture_logs

from pcmrs.gateway import intake, peer_session
from pcmrs.gateway.intake import Intake
from pcmrs.gateway.peer_session import MAX_WAITING, SECOND_WITHIN
from pcmrs.testing.clock import settle
from pcmrs.testing.clock import settle as settle_loop
from tests.unit.gateway.gateway_fakes import WITHIN
from tests.unit.gateway.open_cell import hear_from_others, pass_barrier


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


@pytest.mark.parametrize("queued", ["start_autodigitz; start_registrati;", "end_session_back;"])
async def test_stop_reaches_a_client_however_many_came_after_it(
    cell: Any, monkeypatch: pytest.MonkeyPatch, queued: str
) -> None:
    """What waits, or has steps to come, is not idle: its peer_session is not forgotten."""
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


async def arrived(cell: Any) -> None:
    """Returns once everything sent to the planner's link before has been received."""
    assert (await cell.ask("get_jnt_angsxxxx_#900;")).startswith("900_accepted")


def refused(cell: Any, reason: str) -> list[str]:
    """What has been journalled and published as refused for that reason."""
    return [event.text for event in cell.core.events if event.fields["reason"] == reason]


@pytest.mark.parametrize("second", ["execute_confirmx", "adjust_tranxxxxx_0_0_0.001", "end_session_back"])
async def test_motion_during_another_is_acknowledged_but_refused(cell: Any, second: str) -> None:
    """It is never performed."""
    cell.core.gates["approach"].clear()
    assert await cell.tell("execute_motionxx;") == "ack"
    assert await cell.tell(f"{second};") == "ack"
    (text,) = refused(cell, "busy")
    assert second[:16] in text
    assert (await cell.ask(f"{second}_#1;")).endswith("_busy;")
    assert len(refused(cell, "busy")) == 2  # each has a row
    cell.core.open_gates()
    await arrived(cell)
    await settle_loop()
    assert cell.core.operations == ["approach"]
    assert await cell.tell(f"{second};") == "ack"  # the first has ended, so that this one begins
    await arrived(cell)
    assert len(cell.core.operations) > 1


async def test_motionless_command_runs_beside_a_motion(cell: Any) -> None:
    """The daemon decides whether it may: behind a motion in the gateway a plan would change what the tool goes to."""
    cell.core.gates["approach"].clear()
    await cell.tell("execute_motionxx;")
    cell.core.results["register"] = {"residual": 0.001}
    await cell.tell("start_registrati;")
    assert await cell.replies.received.get() == "1.000000"
    assert cell.core.operations == ["approach", "register"]


async def test_a_motion_waits_for_the_plan_that_came_before_it(cell: Any) -> None:
    cell.core.gates["plan"].clear()
    for command in ("target_rotxxxxxx_0_0_0_1", "target_tslxxxxxx_0_0_0", "execute_motionxx", "start_registrati"):
        await cell.tell(f"{command};")
    assert cell.core.operations == ["plan"]
    came = cell.clock.now
    cell.clock.now += 0.05
    cell.core.results["register"] = {"residual": 0.001}
    cell.core.open_gates()
    assert await cell.replies.received.get() == "1.000000"
    assert cell.core.operations == ["plan", "approach", "register"]
    assert cell.core.ages[1] == came  # its wait here is a part of the time within which its checks begin


async def test_motion_behind_a_long_command_is_refused_after_its_time(cell: Any) -> None:
    cell.core.gates["digitize_all"].clear()
    for command in ("start_autodigitz", "execute_homexxxx"):
        await cell.tell(f"{command};")
    assert (await cell.ask("execute_motionxx_#1;")).endswith("_busy;")  # one waits already
    cell.clock.expire(0.1)
    await arrived(cell)
    assert [text[:16] for text in refused(cell, "busy")] == ["execute_motionxx", "execute_homexxxx"]
    assert (await cell.ask("execute_bkoffset_#2;")).startswith("2_accepted")  # none waits any more
    cell.core.open_gates()
    await arrived(cell)
    await settle_loop()
    assert cell.core.operations == ["digitize_all", "back_off"]


async def test_a_motion_that_the_loop_takes_up_too_late_is_refused(cell: Any) -> None:
    cell.core.gates["connect"].clear()
    for command in ("rob_conn_onxxxxx", "execute_homexxxx"):
        await cell.tell(f"{command};")
    cell.clock.now += 0.2
    cell.core.open_gates()
    await arrived(cell)
    await settle_loop()
    assert len(refused(cell, "expired")) == 1
    assert cell.core.operations == ["connect"]


async def test_next_part_of_a_command_starts_when_the_last_has_ended(cell: Any) -> None:
    cell.core.branches["placement"] = "placed"
    cell.core.gates["back_off"].clear()
    reply = asyncio.ensure_future(cell.ask("end_session_back_#1;"))
    await cell.core.arrived.wait()
    cell.clock.now += 5.0
    cell.core.open_gates()
    assert (await reply).startswith("1_accepted")
    assert cell.core.operations == ["back_off", "to_initial", "reinit", "reinit"]
    assert cell.core.ages[1:] == [cell.clock.now] * 3


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


async def test_the_acknowledgement_does_not_wait_for_the_operation(cell: Any) -> None:
    cell.core.gates["digitize_all"].clear()
    assert await cell.tell("start_autodigitz;") == "ack"
    await cell.core.arrived.wait()
    assert cell.core.operations == ["digitize_all"]
    command = cell.core.commands[0]
    assert (command.branch, command.source) == ("digitization", f"udp:planner:127.0.0.1:{cell.client.port}")


async def test_a_late_result_is_never_sent(cell: Any) -> None:
    cell.core.results["register"] = {"residual": 0.002}
    cell.core.gates["register"].clear()
    assert await cell.tell("start_registrati;") == "ack"
    await cell.core.arrived.wait()
    cell.clock.expire(0.4)  # so long clients wait
    assert await cell.replies.received.get() == "no_data_returned;"
    cell.core.gates["register"].set()
    # Commands of a peer run in order, so the registration has ended when this second one has.
    cell.core.results["use_previous"] = {"residual": 0.001}
    assert await cell.tell("start_useprevreg;") == "ack"
    assert await cell.replies.received.get() == "1.000000"


async def test_after_a_stall_of_the_loop_no_second_datagram_is_sent(cell: Any) -> None:
    cell.core.results["register"] = {"residual": 0.002}
    cell.core.gates["register"].clear()
    assert await cell.tell("start_registrati;") == "ack"
    await cell.core.arrived.wait()
    cell.clock.now += 0.679  # the loop stands still, and the timeout of 0.35 s is noticed after that
    cell.clock.expire(0.4)
    await pass_barrier(cell)
    cell.core.gates["register"].set()
    await pass_barrier(cell)
    assert await cell.tell("rob_conn_onxxxxx;") == "ack"  # the next that comes is this acknowledgement
    assert cell.replies.received.empty()


async def test_set_initial_passes_a_running_command(cell: Any) -> None:
    """The present joints are meant, not those after it."""
    cell.core.initial_joints = [0.2] * 7
    cell.core.gates["connect"].clear()
    assert await cell.tell("rob_conn_onxxxxx;", cell.robot) == "ack"
    assert await cell.tell("get_jnt_setinitx;", cell.robot) == "ack"
    assert [float(token) for token in (await cell.replies.received.get()).split("_")[:7]] == [0.2] * 7


async def test_reads_pass_a_running_command(cell: Any) -> None:
    cell.core.gates["digitize_all"].clear()
    await cell.tell("start_autodigitz;")
    assert await cell.tell("get_jnt_angsxxxx;", cell.robot) == "ack"
    joints = await cell.replies.received.get()
    assert joints.endswith("_")
    assert [float(token) for token in joints.split("_")[:7]] == pytest.approx([0.1 * i for i in range(7)])
    assert await cell.tell("get_jnt_setinitx;", cell.robot) == "ack"
    assert await cell.replies.received.get() == "no_data_returned;"
    assert await cell.tell("get_eff_posexxxx;", cell.robot) == "ack"
    assert (await cell.replies.received.get()).count("_") == 7


async def test_repeated_id_returns_recorded_verdict_and_runs_nothing(cell: Any) -> None:
    cell.core.refusals["connect"] = "no_answer"
    first = await cell.ask("rob_conn_onxxxxx_#007;")
    cell.core.refusals.clear()
    assert await cell.ask("rob_conn_onxxxxx_#007;") == first == "007_rejected_robot_1_no_answer;"
    assert cell.core.operations == ["connect"]


async def test_a_repeat_while_running_attaches(cell: Any) -> None:
    cell.core.gates["connect"].clear()
    cell.client.send("rob_conn_onxxxxx_#1;", cell.planner)
    cell.client.send("rob_conn_onxxxxx_#1;", cell.planner)
    await pass_barrier(cell)
    cell.core.gates["connect"].set()
    assert await cell.client.received.get() == "1_accepted_robot_1;"
    await pass_barrier(cell)
    assert cell.core.operations == ["connect"]


async def test_stop_passes_what_runs_and_rejects_what_waits(cell: Any) -> None:
    cell.core.gates["digitize_all"].clear()
    await cell.tell("start_autodigitz;")
    await cell.tell("start_registrati;")  # waits behind the digitization
    reply = await cell.ask("stop_now_xxxxxxx_#9;", cell.robot)
    assert reply == "9_accepted_robot_1;"
    assert cell.core.stops == [f"udp:robot:127.0.0.1:{cell.client.port}"]
    assert await cell.replies.received.get() == "no_data_returned;"
    cell.core.gates["digitize_all"].set()
    await cell.tell("rob_conn_onxxxxx;")
    await pass_barrier(cell)
    assert cell.core.operations == ["digitize_all", "connect"]


async def test_stop_without_an_id_waits_for_nothing_either(cell: Any) -> None:
    cell.core.gates["digitize_all"].clear()
    await cell.tell("start_autodigitz;", cell.robot)
    assert await cell.tell("stop_now_xxxxxxx;", cell.robot) == "ack"
    await pass_barrier(cell, cell.robot)
    assert cell.core.operations == ["digitize_all"]
    assert len(cell.core.stops) == 1


async def test_commands_of_one_peer_run_in_the_order_of_their_arrival(cell: Any) -> None:
    cell.core.gates["connect"].clear()
    for command in ("rob_conn_onxxxxx", "start_autodigitz", "rob_conn_offxxxx"):
        await cell.tell(f"{command};")
    assert cell.core.operations == ["connect"]
    cell.core.gates["connect"].set()
    cell.core.results["register"] = {"residual": 0.001}
    await cell.tell("start_registrati;")
    await cell.replies.received.get()
    assert cell.core.operations == ["connect", "digitize_all", "disconnect", "register"]


async def test_a_full_queue_refuses_and_counts(cell: Any) -> None:
    cell.core.gates["connect"].clear()
    for _ in range(MAX_WAITING):
        await cell.tell("rob_conn_onxxxxx;")
    assert (await cell.ask("rob_conn_onxxxxx_#1;")).endswith("queue_full;")
    assert cell.gateway.counters.overflowed == 1


async def test_a_next_part_counts_from_the_end_of_the_one_before(cell: Any) -> None:
    """The loop was held up before it could begin it."""
    cell.core.branches["placement"] = "placed"
    came = cell.clock.now

    def hold_up() -> None:
        cell.clock.now += 5.0

    cell.core.after_accepting = hold_up
    assert (await cell.ask("end_session_back_#1;")).startswith("1_accepted")
    assert cell.core.ages == [came, came, came + 5.0, came + 10.0]


async def test_an_id_of_another_command_is_refused_and_reported(cell: Any) -> None:
    first = await cell.ask("adjust_tranxxxxx_0_0_0.001_#7;")
    assert first.startswith("7_accepted_placement")
    for other in ("execute_bkoffset", "adjust_tranxxxxx_0_0_0.002"):
        assert await cell.ask(f"{other}_#7;") == "7_rejected_placement_retracted_id_reused;"
    assert cell.core.operations == ["nudge"]
    texts = refused(cell, "id_reused")
    assert [text[:16] for text in texts] == ["execute_bkoffset", "adjust_tranxxxxx"]
    assert texts[0].endswith("has used the id '7' before, for adjust_tranxxxxx: give every command its own id.")
    assert await cell.ask("adjust_tranxxxxx_0_0_0.001_#7;") == first, "a repeat gets the recorded answer"
    assert cell.core.operations == ["nudge"]


async def test_an_id_of_a_running_command_is_refused_at_once(cell: Any) -> None:
    cell.core.gates["approach"].clear()
    cell.client.send("execute_motionxx_#7;", cell.planner)
    await cell.core.arrived.wait()
    assert await cell.ask("rob_conn_offxxxx_#7;") == "7_rejected_robot_1_id_reused;"
    cell.client.send("execute_motionxx_#7;", cell.planner)  # a repeat waits for the answer to the first
    await arrived(cell)
    cell.core.open_gates()
    assert await cell.client.received.get() == "7_accepted_placement_retracted;"
    assert cell.core.operations == ["approach"]


async def test_an_id_of_an_earlier_plan_does_not_accept_a_new_one(cell: Any) -> None:
    """The command is the same; the rotation that was sent before it is not."""
    await cell.ask("target_rotxxxxxx_0_0_0_1_#1;")
    first = await cell.ask("target_tslxxxxxx_0.1_0_0_#2;")
    assert first.startswith("2_accepted")
    assert await cell.tell("target_rotxxxxxx_0_0_0_1;") == "ack"
    assert await cell.ask("target_tslxxxxxx_0.1_0_0_#2;") == first, "all of it was sent again"
    await cell.ask("target_rotxxxxxx_1_0_0_0_#3;")
    assert (await cell.ask("target_tslxxxxxx_0.1_0_0_#2;")).endswith("_id_reused;")
    assert (await cell.ask("execute_motionxx_#4;")).endswith("_plan_not_accepted;")
    assert cell.core.operations == ["plan"]
    assert (await cell.ask("target_tslxxxxxx_0.1_0_0_#5;")).startswith("5_accepted"), "the copy has broken nothing"


async def test_a_part_of_a_plan_with_a_used_id_drops_the_others(cell: Any) -> None:
    await cell.ask("target_rotxxxxxx_0_0_0_1_#1;")
    await cell.ask("rob_conn_onxxxxx_#2;")
    assert (await cell.ask("target_rotxxxxxx_1_0_0_0_#2;")).endswith("_id_reused;")
    assert (await cell.ask("target_tslxxxxxx_0.1_0_0_#3;")).endswith("_no_rotation;")
    assert (await cell.ask("execute_motionxx_#4;")).endswith("_plan_not_accepted;")
    assert cell.core.operations == ["connect"]
