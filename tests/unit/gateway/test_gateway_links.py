from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.gateway.intake import Intake, source_of
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.peer_session import MAX_WAITING
from pcmrs.gateway.settings import GatewayConfig, LinkConfig
from tests.unit.gateway.gateway_fakes import CONFIRMED, WITHIN, FakeCore, ManualClock, UdpClient


async def settle(cell: Any, address: tuple[str, int] | None = None) -> None:
    """Returns once everything sent to that link before has been received: datagrams of one socket stay in order."""
    barrier = next(_barriers)
    assert (await cell.ask(f"get_jnt_angsxxxx_#{barrier};", address)).startswith(f"{barrier}_accepted")


_barriers = iter(range(900_000, 999_999))


async def plan_pose(cell: Any) -> None:
    assert await cell.tell("target_rotxxxxxx_0_0_0_1;") == "ack"
    assert await cell.tell("target_tslxxxxxx_0.1_0.2_0.3;") == "ack"


async def test_the_acknowledgement_does_not_wait_for_the_operation(cell: Any) -> None:
    cell.core.gates["digitize_all"].clear()
    assert await cell.tell("start_autodigitz;") == "ack"
    await cell.core.arrived.wait()
    assert cell.core.operations == ["digitize_all"]
    command = cell.core.commands[0]
    assert (command.branch, command.source) == ("digitization", f"udp:planner:127.0.0.1:{cell.client.port}")


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
    await settle(cell)
    cell.core.gates["register"].set()
    await settle(cell)
    assert await cell.tell("rob_conn_onxxxxx;") == "ack"  # the next that comes is this acknowledgement
    assert cell.replies.received.empty()


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


@pytest.mark.parametrize("motion", ["execute_motionxx", "execute_confirmx", "adjust_tranxxxxx_0_0_0.001"])
async def test_after_a_refused_plan_no_approach_is_submitted(cell: Any, motion: str) -> None:
    cell.core.refusals["plan"] = "unreachable"
    await plan_pose(cell)
    # The control panel uses another socket of the same workstation.
    panel = await UdpClient.open()
    await settle(cell)
    reply = await panel.ask(f"{motion}_#1;", cell.robot)
    assert reply == "1_rejected_placement_retracted_plan_not_accepted;"
    assert (await panel.ask("execute_bkoffset_#2;", cell.robot)).startswith("2_accepted")  # retreats stay possible
    cell.core.refusals.clear()
    await plan_pose(cell)
    await settle(cell)
    assert (await panel.ask(f"{motion}_#3;", cell.robot)).startswith("3_accepted_placement")
    assert cell.core.operations.count("plan") == 2
    panel.transport.close()


async def test_half_a_plan_holds_motion_back_too(cell: Any) -> None:
    await cell.ask("target_rotxxxxxx_0_0_0_1_#1;")
    assert (await cell.ask("execute_motionxx_#2;")).endswith("plan_not_accepted;")
    cell.clock.now += 1.5
    assert await cell.ask("target_tslxxxxxx_0_0_0_#3;") == "3_rejected_toolplan_0_rotation_too_old;"
    assert (await cell.ask("execute_motionxx_#4;")).endswith("plan_not_accepted;")
    assert cell.core.commands == []


async def test_an_announced_plan_holds_motion_back_too(cell: Any) -> None:
    await cell.ask("img_fid_numxxxxx_02_#1;")
    assert (await cell.ask("execute_motionxx_#2;")).endswith("plan_not_accepted;")
    assert cell.core.commands == []


async def test_incomplete_landmark_series_is_refused_and_bars_motion(cell: Any) -> None:
    await cell.ask("img_fid_numxxxxx_02_#1;")
    await cell.ask("img_fid_pntxxxxx_00_0_0_0_#2;")
    assert await cell.ask("img_fid_lastrecv_#3;") == "3_rejected_registration_000_incomplete_series;"
    assert (await cell.ask("execute_motionxx_#4;")).endswith("plan_not_accepted;")
    assert (await cell.ask("start_useprevreg_#5;")).startswith("5_accepted_registration")
    assert (await cell.ask("execute_motionxx_#6;")).startswith("6_accepted")


async def test_rotation_and_translation_of_two_clients_are_no_plan(cell: Any) -> None:
    other = await UdpClient.open()
    await cell.ask("target_rotxxxxxx_0_0_0_1_#1;")
    assert (await other.ask("target_tslxxxxxx_0_0_0_#1;", cell.planner)).endswith("no_rotation;")
    assert cell.core.commands == []
    other.transport.close()


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
    await settle(cell)
    cell.core.gates["connect"].set()
    assert await cell.client.received.get() == "1_accepted_robot_1;"
    await settle(cell)
    assert cell.core.operations == ["connect"]


async def test_the_same_id_of_another_peer_is_another_command(cell: Any) -> None:
    other = await UdpClient.open()
    await cell.ask("rob_conn_onxxxxx_#1;")
    await other.ask("rob_conn_onxxxxx_#1;", cell.planner)
    assert len({(command.source, command.id) for command in cell.core.commands}) == 2
    other.transport.close()


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
    await settle(cell)
    assert cell.core.operations == ["digitize_all", "connect"]


async def test_stop_without_an_id_waits_for_nothing_either(cell: Any) -> None:
    cell.core.gates["digitize_all"].clear()
    await cell.tell("start_autodigitz;", cell.robot)
    assert await cell.tell("stop_now_xxxxxxx;", cell.robot) == "ack"
    await settle(cell, cell.robot)
    assert cell.core.operations == ["digitize_all"]
    assert len(cell.core.stops) == 1


async def test_a_stop_that_is_not_confirmed_is_no_success(cell: Any) -> None:
    cell.core.stands = False
    assert await cell.ask("stop_now_xxxxxxx_#9;", cell.robot) == "9_failed_robot_1_hold_not_confirmed;"


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


@pytest.mark.parametrize(
    ("digitized", "operations"), [("0", ["digitize_one"]), ("1", ["redigitize_one", "digitize_one"])]
)
async def test_digitizing_one_reopens_it_when_all_were(cell: Any, digitized: str, operations: list[str]) -> None:
    cell.core.branches["digitization"] = digitized
    assert (await cell.ask("img_dig_digitize_03_#1;")).startswith("1_accepted_digitization")
    assert cell.core.operations == operations
    assert cell.core.commands[-1].arguments == {"index": 3}


async def test_ending_a_session_stops_at_the_first_rejection(cell: Any) -> None:
    cell.core.branches["placement"] = "placed"
    cell.core.refusals["to_initial"] = "no_initial_joints"
    assert await cell.ask("end_session_back_#1;") == "1_rejected_placement_placed_no_initial_joints;"
    assert cell.core.operations == ["back_off", "to_initial"]
    cell.core.commands.clear()
    cell.core.refusals.clear()
    cell.core.branches["placement"] = "retracted"
    assert await cell.ask("end_session_back_#2;") == "2_accepted_toolplan_0;"
    assert cell.core.operations == ["to_initial", "reinit", "reinit"]


async def test_confirm_returns_the_measured_pose_and_its_errors(cell: Any) -> None:
    cell.core.results["confirm"] = CONFIRMED
    reply = await cell.ask("execute_confirmx_#1;")
    assert reply == "1_accepted_placement_retracted_0.1_0.2_0.3_0_0_0_1_0.25_0.0572958;"


@pytest.mark.parametrize(
    ("command", "operation", "arguments"),
    [
        ("icp_digitizexxxx", "digitization.digitize_surface", {}),
        ("icp_clear_prevxx", "digitization.clear_surface_point", {}),
        ("icp_clear_allxxx", "digitization.clear_surface", {}),
        ("icp_registerxxxx_/m/a_b.stl", "registration.refine", {"surface": "a_b.stl"}),
        (r"icp_registerxxxx_C:\lab data\skin_2.ply", "registration.refine", {"surface": "skin_2.ply"}),
        ("icp_registerxxxx_../../etc/passwd", "registration.refine", {"surface": "passwd"}),
        ("icp_registerxxxx_/", "registration.refine", {"surface": ""}),
    ],
)
async def test_surface_commands_drive_their_operations(
    cell: Any, command: str, operation: str, arguments: dict[str, Any]
) -> None:
    branch, name = operation.split(".")
    cell.core.results["refine"] = {"landmarks": {"residual": 0.002}, "tre": 0.001}
    assert await cell.ask(f"{command}_#1;") == f"1_accepted_{branch}_{cell.core.branches[branch]};"
    (asked,) = cell.core.commands
    assert (asked.branch, asked.operation, asked.arguments) == (branch, name, arguments)


async def test_refinement_is_acknowledged_without_a_second_datagram(cell: Any) -> None:
    assert await cell.tell("icp_registerxxxx_/m/a_b.stl;") == "ack"
    await settle(cell)
    assert cell.replies.received.empty()


async def test_refused_refinement_is_answered_with_its_reason(cell: Any) -> None:
    cell.core.refusals["refine"] = "unknown_surface"
    assert await cell.ask("icp_registerxxxx_/m/no.stl_#1;") == "1_rejected_registration_000_unknown_surface;"


async def test_a_daemon_that_breaks_is_answered_for(cell: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(command: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(cell.core, "submit", broken)
    assert await cell.ask("rob_conn_onxxxxx_#1;") == "1_failed_robot_1_internal_error;"


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
    await settle(cell)
    assert cell.gateway.counters.refused == len(bad)
    assert cell.core.events[0].fields["source"] == f"udp:planner:127.0.0.1:{cell.client.port}"
    assert cell.core.commands == []
    assert cell.client.received.empty()
    assert cell.replies.received.empty()


async def test_refusal_by_the_gateway_is_reported_with_its_reason(cell: Any) -> None:
    assert (await cell.ask("target_tslxxxxxx_0_0_0.1_#5;")).endswith("_no_rotation;")
    (event,) = cell.core.events
    assert event.fields == {"count": 1, "source": f"udp:planner:127.0.0.1:{cell.client.port}", "reason": "no_rotation"}


async def test_the_mep_link_does_not_reply_and_logs_poses(cell: Any) -> None:
    cell.client.send("save_planandreal;", cell.mep)
    await settle(cell, cell.mep)
    assert cell.replies.received.empty()
    assert (await cell.ask("save_continupose_#1;")).endswith("_busy;")


async def test_tool_points_from_mixed_reality_reach_the_planner(cell: Any) -> None:
    cell.client.send("__msg_toolpose_1_2_3_4_5_6.5", cell.planner)
    assert await cell.stream.received.get() == "__msg_toolpose_1.00000_2.00000_3.00000_4.00000_5.00000_6.50000"


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


@pytest.mark.parametrize("field", ["client_host", "mixed_reality_host"])
@pytest.mark.parametrize("host", ["headset.local", "::1", "", "192.0.2.300"])
def test_streams_go_to_ipv4_addresses_only(field: str, host: str) -> None:
    with pytest.raises(ConfigurationError, match=f"{field} is '{host}'") as error:
        msgspec.convert({field: host}, GatewayConfig)
    assert error.value.fields == {field: host}


def test_only_loopback_peers_may_be_listed() -> None:
    with pytest.raises(ConfigurationError, match="loopback"):
        GatewayConfig(unsigned_peers=("192.0.2.1",))


async def test_port_in_use_is_an_error(cell: Any, tmp_path: Path) -> None:
    config = GatewayConfig(planner=LinkConfig(port=cell.planner[1]))
    with pytest.raises(ConfigurationError, match="cannot be bound"):
        async with open_gateway(FakeCore(), config, ManualClock(), tmp_path):
            pass
