"""Plans of Slicer are checked as a whole and converted to metres."""

from __future__ import annotations

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
from pcmrs.spatial import Transform, distance, rotation_angle
from tests.support import openigtlink_bytes as wire
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
