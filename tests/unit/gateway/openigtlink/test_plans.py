"""Plans of Slicer are checked as a whole, converted to metres and decided one after the other; Stop passes them."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.plus.messages import matrix_mm
from pcmrs.errors import RefusalError
from pcmrs.gateway.openigtlink import plans
from pcmrs.messages import Command, Verdict
from pcmrs.spatial import Transform, distance, rotation_angle
from tests.support import openigtlink_bytes as wire
from tests.unit.gateway.gateway_fakes import WITHIN, UdpClient
from tests.unit.gateway.igtl_client import planned_mm
from tests.unit.gateway.openigtlink.slicer_room import FACES, LANDMARKS_MM, TARGET, Room

BAD_TARGETS = {
    "identity": (np.eye(4), "wrong_unit"),
    "metres": (planned_mm((0.04, 0.06, 0.08)), "wrong_unit"),
    "far": (planned_mm((40.0, 1000.5, 80.0)), "wrong_unit"),
    "nan": (planned_mm((math.nan, 0.0, 0.0)), "not_finite"),
    "scaled": (planned_mm() @ np.diag([1.01, 1.01, 1.01, 1.0]), "not_rigid"),
    "mirrored": (planned_mm() @ np.diag([-1.0, 1.0, 1.0, 1.0]), "mirrored"),
}


finite = st.floats(width=32)


def planned(plan: Callable[..., Any], *sent: Any) -> Any:
    """The arguments, or None where they are refused with a reason."""
    try:
        return plan(*sent)
    except RefusalError as refusal:
        return None if refusal.text and refusal.refusal_code else "no reason"


async def test_a_target_is_planned_in_metres(room: Room) -> None:
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert await room.slicer.verdict() == "accepted toolplan.plan"
    (command,) = room.core.commands
    assert (command.branch, command.operation) == ("toolplan", "plan")
    assert command.source.startswith("openigtlink:127.0.0.1:")
    assert command.arguments["position"] == pytest.approx([0.04, 0.06, 0.08])
    assert command.arguments["quat_xyzw"] == pytest.approx([0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])


async def test_landmarks_are_planned_in_metres(room: Room) -> None:
    room.slicer.send(wire.points("Landmarks", LANDMARKS_MM, FACES))
    assert await room.slicer.verdict() == "accepted registration.plan_landmarks"
    (command,) = room.core.commands
    found = command.arguments["landmarks"]
    assert [landmark["name"] for landmark in found] == ["left", "p1", "nasion"]
    np.testing.assert_allclose([landmark["position"] for landmark in found], np.array(LANDMARKS_MM) * 1e-3)


@pytest.mark.parametrize("bad", BAD_TARGETS)
async def test_invalid_target_is_refused_with_the_reason(room: Room, bad: str) -> None:
    matrix, code = BAD_TARGETS[bad]
    room.slicer.send(wire.transform(TARGET, matrix))
    assert (await room.slicer.verdict()).startswith(f"rejected toolplan.plan {code}: ")
    status = await room.slicer.status(2)
    assert status.error_name == code
    assert status.text
    assert room.core.commands == []


@pytest.mark.parametrize(
    ("positions", "code"),
    [
        (LANDMARKS_MM[:2], "wrong_count"),
        ([(float(x), 0.0, 0.0) for x in range(101)], "wrong_count"),
        ([(0.08, 0.01, 0.0), (-0.08, 0.01, 0.0), (0.0, 0.0955, -0.02)], "wrong_unit"),
        ([*LANDMARKS_MM, (0.0, 2000.0, 0.0)], "wrong_unit"),
        ([*LANDMARKS_MM, (0.0, math.inf, 0.0)], "not_finite"),
    ],
)
async def test_invalid_landmarks_are_refused(room: Room, positions: Any, code: str) -> None:
    room.slicer.send(wire.points("Landmarks", positions, [""] * len(positions)))
    assert (await room.slicer.verdict()).startswith(f"rejected registration.plan_landmarks {code}: ")
    assert room.core.commands == []
    assert [event.fields["reason"] for event in room.core.events] == [code]


@given(st.lists(finite, min_size=12, max_size=12))
def test_a_matrix_is_a_plan_or_is_refused(numbers: list[float]) -> None:
    arguments = planned(plans.target, np.vstack([np.array(numbers).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]]))
    if arguments is not None:
        assert np.linalg.norm(arguments["quat_xyzw"]) == pytest.approx(1.0)
        assert np.linalg.norm(arguments["position"]) * 1e3 >= plans.NEAREST_MM
        assert max(np.abs(arguments["position"])) * 1e3 <= plans.FARTHEST_MM


@given(
    st.lists(st.floats(-1000.0, 1000.0, width=32), min_size=3, max_size=3),
    st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
)
def test_a_rigid_matrix_in_mm_is_the_same_plan_in_metres(position_mm: list[float], rotvec: list[float]) -> None:
    sent = Transform.from_rotvec(np.array(position_mm) * 1e-3, rotvec)
    arguments = planned(plans.target, matrix_mm(sent).astype(np.float32))
    if np.linalg.norm(position_mm) > 1.01 * plans.NEAREST_MM:
        taken = Transform.from_quat_xyzw(arguments["position"], arguments["quat_xyzw"])
        assert distance(sent, taken) < 1e-6
        assert rotation_angle(sent, taken) < 1e-6


@given(st.lists(st.tuples(finite, finite, finite), max_size=6))
def test_points_are_a_plan_or_are_refused(positions: list[tuple[float, float, float]]) -> None:
    arguments = planned(plans.landmarks, positions, [""] * len(positions))
    if arguments is not None:
        found = np.array([landmark["position"] for landmark in arguments["landmarks"]])
        np.testing.assert_allclose(found * 1e3, np.array(positions), rtol=1e-9, atol=1e-9)
        assert len(found) >= plans.FEWEST


async def test_while_a_plan_is_decided_only_the_newest_waits(room: Room) -> None:
    room.core.gates["plan"].clear()
    room.slicer.send(wire.transform(TARGET, planned_mm((9.0, 60.0, 80.0))))
    async with asyncio.timeout(WITHIN):
        await room.core.arrived.wait()
    for x in range(30):
        room.slicer.send(wire.transform(TARGET, planned_mm((10.0 + x, 60.0, 80.0))))
    room.slicer.send(wire.points("Landmarks", LANDMARKS_MM, FACES))
    while room.gateway.counters.received < 32:
        await room.slicer.next("CoilToImage")
    room.core.gates["plan"].set()
    assert [await room.slicer.verdict() for _ in range(3)] == [
        "accepted toolplan.plan",
        "accepted toolplan.plan",
        "accepted registration.plan_landmarks",
    ]
    first, newest, _ = room.core.commands
    assert first.arguments["position"][0] == pytest.approx(0.009)
    assert newest.arguments["position"][0] == pytest.approx(0.039)


@pytest.mark.parametrize("by_daemon", [True, False])
async def test_a_refused_plan_holds_the_motions_of_its_host_back(room: Room, by_daemon: bool) -> None:
    panel, robot = await UdpClient.open(), room.gateway.addresses["robot"]
    assert (await panel.ask("execute_motionxx_#1;", robot)).startswith("1_accepted")
    if by_daemon:
        room.core.refusals["plan"] = "unreachable"
    room.slicer.send(wire.transform(TARGET, planned_mm((41.0, 60.0, 80.0)) if by_daemon else np.eye(4)))
    assert (await room.slicer.verdict()).startswith("rejected")
    room.core.refusals.clear()
    assert (await panel.ask("execute_motionxx_#2;", robot)).endswith("plan_not_accepted;")
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("accepted")
    assert (await panel.ask("execute_motionxx_#3;", robot)).startswith("3_accepted")
    panel.transport.close()


async def test_stop_passes_a_plan_under_way_and_rejects_what_waits(room: Room) -> None:
    room.core.gates["plan"].clear()
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    async with asyncio.timeout(WITHIN):
        await room.core.arrived.wait()
    room.slicer.send(wire.points("Landmarks", LANDMARKS_MM, FACES) + wire.string("Anything", " Stop\n"))
    assert (await room.slicer.verdict()).startswith("rejected registration.plan_landmarks stopped")
    assert await room.slicer.verdict() == "accepted stop"
    assert len(room.core.stops) == 1
    room.core.gates["plan"].set()
    assert await room.slicer.verdict() == "accepted toolplan.plan"  # the one under way is the daemon's to end
    room.slicer.send(wire.transform(TARGET, planned_mm((41.0, 60.0, 80.0))))
    assert await room.slicer.verdict() == "accepted toolplan.plan"
    assert room.core.operations == ["plan", "plan"]


async def test_a_stop_that_is_not_confirmed_is_no_success(room: Room) -> None:
    room.core.stands = False
    room.slicer.send(wire.string("S", "stop"))
    assert (await room.slicer.verdict()).startswith("failed stop hold_not_confirmed")


async def test_a_daemon_that_breaks_is_answered_for(room: Room, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(command: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(room.core, "submit", broken)
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("failed toolplan.plan internal_error")


async def test_plan_that_is_not_accepted_without_a_reason_is_answered(
    room: Room, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def undecided(command: Command) -> Verdict:
        return Verdict(id=command.id, branch="toolplan", operation="plan", decision="unknown", state="0", sequence=1)

    monkeypatch.setattr(room.core, "submit", undecided)
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("unknown toolplan.plan unknown")
    assert (await room.slicer.status(2)).error_name == "unknown"
