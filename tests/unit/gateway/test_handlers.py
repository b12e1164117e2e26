"""Handlers: series, pairs and locks of plans, and the operations of each command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import RefusalError
from pcmrs.gateway.commands import PlanKind
from pcmrs.gateway.handlers import PAIR_WINDOW, NumberedSeries, PlanLock, PosePair
from tests.unit.gateway.gateway_fakes import CONFIRMED, UdpClient, pass_look
from tests.unit.gateway.open_cell import open_cell, pass_barrier


async def plan_pose(cell: Any) -> None:
    assert await cell.tell("target_rotxxxxxx_0_0_0_1;") == "ack"
    assert await cell.tell("target_tslxxxxxx_0.1_0.2_0.3;") == "ack"


@given(st.integers(1, 12), st.lists(st.integers(0, 13), max_size=16))
def test_a_series_is_complete_exactly_when_every_index_came_once(count: int, indices: list[int]) -> None:
    series = NumberedSeries("landmark")
    series.announce(count)
    try:
        for index in indices:
            series.add(index, [float(index), 0.0, 0.0])
        numbers = series.finish()
    except RefusalError:
        assert sorted(indices) != list(range(count))
        with pytest.raises(RefusalError, match="announce"):
            series.add(0, [0.0, 0.0, 0.0])
    else:
        assert sorted(indices) == list(range(count))
        assert numbers == [[float(i), 0.0, 0.0] for i in range(count)]


@given(st.integers(1, 6).flatmap(lambda count: st.permutations(range(count))), st.integers(0, 8), st.integers(0, 6))
def test_one_landmark_too_many_drops_the_series(order: list[int], extra: int, place: int) -> None:
    """Also the last one, of a series that was complete without it."""
    series = NumberedSeries("landmark")

    def send(indices: list[int]) -> None:
        series.announce(len(order))
        for index in indices:
            series.add(index, [0.0, 0.0, 0.0])

    with pytest.raises(RefusalError) as refusal:
        send([*order[:place], extra, *order[place:]])
    assert refusal.value.refusal_code == "bad_series"
    fault = "came twice" if extra < len(order) else f"lies outside the {len(order)} announced"
    assert f"Landmark {extra} {fault};" in refusal.value.text
    with pytest.raises(RefusalError, match="announce"):
        series.finish()


def test_a_new_announcement_drops_the_points_before_it() -> None:
    series = NumberedSeries("landmark")
    series.announce(1)
    series.add(0, [1.0, 1.0, 1.0])
    series.announce(1)
    with pytest.raises(RefusalError) as refusal:
        series.finish()
    assert refusal.value.refusal_code == "incomplete_series"


@pytest.mark.parametrize(("age", "fits"), [(PAIR_WINDOW, True), (PAIR_WINDOW + 0.001, False)])
def test_a_pair_closes_within_its_window(age: float, fits: bool) -> None:
    pair = PosePair()
    pair.rotate([0.0, 0.0, 0.0, 1.0], 0.0)
    if fits:
        assert pair.translate([1.0, 2.0, 3.0], age)["quat_xyzw"] == [0.0, 0.0, 0.0, 1.0]
    else:
        with pytest.raises(RefusalError, match="limit is 1 s"):
            pair.translate([1.0, 2.0, 3.0], age)
    with pytest.raises(RefusalError, match="without a rotation"):
        pair.translate([1.0, 2.0, 3.0], age)


def test_a_second_rotation_replaces_the_first() -> None:
    pair = PosePair()
    pair.rotate([1.0, 0.0, 0.0, 0.0], 0.0)
    pair.rotate([0.0, 1.0, 0.0, 0.0], 0.9)
    assert pair.translate([0.0, 0.0, 0.0], 1.8)["quat_xyzw"] == [0.0, 1.0, 0.0, 0.0]


@given(st.lists(st.tuples(st.sampled_from(list(PlanKind)), st.booleans())))
def test_lock_holds_while_a_newest_plan_is_not_accepted(plans: list[tuple[PlanKind, bool]]) -> None:
    """It holds if the newest plan of any kind is not accepted."""
    lock = PlanLock()
    for kind, accepted in plans:
        attempt = lock.attempt(kind)
        if accepted:
            lock.accept(kind, attempt)
    newest = dict(plans)
    assert lock.held == (not all(newest.values()))


def test_acceptance_of_an_older_plan_does_not_open_the_lock() -> None:
    lock = PlanLock()
    older = lock.attempt(PlanKind.POSE)
    lock.attempt(PlanKind.POSE)
    lock.accept(PlanKind.POSE, older)
    assert lock.held


@pytest.mark.parametrize("motion", ["execute_motionxx", "execute_confirmx", "adjust_tranxxxxx_0_0_0.001"])
async def test_after_a_refused_plan_no_approach_is_submitted(cell: Any, motion: str) -> None:
    cell.core.refusals["plan"] = "unreachable"
    await plan_pose(cell)
    # The control panel uses another socket of the same workstation.
    panel = await UdpClient.open()
    await pass_barrier(cell)
    reply = await panel.ask(f"{motion}_#1;", cell.robot)
    assert reply == "1_rejected_placement_retracted_plan_not_accepted;"
    assert (await panel.ask("execute_bkoffset_#2;", cell.robot)).startswith("2_accepted")  # retreats stay possible
    cell.core.refusals.clear()
    await plan_pose(cell)
    await pass_barrier(cell)
    assert (await panel.ask(f"{motion}_#3;", cell.robot)).startswith("3_accepted_placement")
    assert cell.core.operations.count("plan") == 2
    panel.transport.close()


async def test_half_a_plan_holds_motion_back_too(cell: Any) -> None:
    await cell.ask("target_rotxxxxxx_0_0_0_1_#1;")
    assert (await cell.ask("execute_motionxx_#2;")).endswith("plan_not_accepted;")
    cell.clock.now += 1.5
    await pass_look()
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
        ("icp_digitizexxxx", "digitization.digitize_surface", {"points": 100, "slide": True}),
        ("icp_pointxxxxxxx", "digitization.digitize_surface", {}),
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


@pytest.mark.parametrize(
    ("placement", "operations"),
    [("unknown", ["locate"]), ("held", ["back_off"]), ("replanned", ["back_off"]), ("placed", ["back_off"])],
)
async def test_back_off_looks_first_at_an_unknown_arm(cell: Any, placement: str, operations: list[str]) -> None:
    cell.core.branches["placement"] = placement
    await cell.ask("execute_bkoffset_#1;")
    assert cell.core.operations == operations


async def test_back_off_moves_nothing_right_after_it_has_looked(cell: Any) -> None:
    cell.core.branches["placement"] = "unknown"
    cell.core.after_accepting = lambda: cell.core.branches.update(placement="held")
    await cell.ask("execute_bkoffset_#1;")
    assert cell.core.operations == ["locate"]


async def test_session_reinit_says_nothing_of_a_bone_without_a_surgeon(cell: Any) -> None:
    cell.core.branches["treatment"] = "unknown"
    assert await cell.ask("session_reinitxx_#1;") == "1_rejected_toolplan_0_no_surgeon;"
    assert cell.core.commands == []
    cell.core.branches["treatment"] = "ready"
    await cell.ask("session_reinitxx_#2;")
    assert cell.core.operations == ["reinit", "reinit"]


async def test_the_panel_on_site_speaks_for_the_surgeon(tmp_path: Path) -> None:
    async with open_cell(tmp_path, surgeon="A. Surgeon") as cell:
        cell.core.branches["treatment"] = "unknown"
        assert (await cell.ask("session_reinitxx_#1;")).startswith("1_accepted")
        (command,) = cell.core.commands
        assert (command.operation, command.arguments) == ("confirm_clear", {"surgeon": "A. Surgeon"})


GRID = [[0.01, 0.02, 0.1, 0.0, 0.0, 0.0, 1.0], [0.02, 0.02, 0.1, 0.0, 0.0, 0.0, 1.0]]


async def _send_grid(cell: Any, poses: list[list[float]], count: int) -> str:
    await cell.ask(f"grid_numxxxxxxxx_{count:02d}_#1;")
    for index, pose in enumerate(poses):
        await cell.ask(f"grid_posexxxxxxx_{index:02d}_{'_'.join(map(str, pose))}_#{index + 2};")
    return str(await cell.ask("grid_lastrecvxxx_#99;"))


async def test_a_grid_is_planned_whole(cell: Any) -> None:
    cell.core.branches["mapping"] = "unplanned"
    assert await _send_grid(cell, GRID, 2) == "99_accepted_mapping_unplanned;"
    (asked,) = cell.core.commands
    assert (asked.branch, asked.operation) == ("mapping", "plan_grid")
    assert asked.arguments == {"poses": [{"position": each[:3], "quat_xyzw": each[3:]} for each in GRID]}


async def test_an_incomplete_grid_is_refused(cell: Any) -> None:
    cell.core.branches["mapping"] = "unplanned"
    assert await _send_grid(cell, GRID, 3) == "99_rejected_mapping_unplanned_incomplete_series;"
    assert cell.core.commands == []
