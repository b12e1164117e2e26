"""Data of a procedure: what it holds, and what a commit removes."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm import Effect
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Transform
from pcmrs.workflows.data import Landmark, PlacementData, Point, as_message, as_transform, settle


def test_digitization_is_complete_if_every_landmark_has_a_point() -> None:
    landmarks = (Landmark("a", (0.0, 0.0, 0.0)), Landmark("b", (1.0, 0.0, 0.0)))
    first, second = (0.0, 0.1, 0.2), (0.3, 0.4, 0.5)
    open_ones: list[tuple[Point | None, ...]] = [(), (None, None), (first, None), (None, second)]
    for digitized in open_ones:
        assert PlacementData(landmarks=landmarks, digitized=digitized).complete_digitization() == ()
    complete = PlacementData(landmarks=landmarks, digitized=(first, second))
    assert complete.complete_digitization() == (first, second)
    assert PlacementData().complete_digitization() == ()


def test_no_skin_is_kept_without_a_digitization() -> None:
    data = PlacementData(surface=((0.0, 0.0, 0.0),))
    for state, kept in {"000": False, "100": False, "110": True, "111": True}.items():
        assert bool(settle(data, {"registration": state}, []).surface) == kept


POSE = PoseMessage(position=(0.1, 0.2, 0.3), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
FULL = PlacementData(
    landmarks=(Landmark("nasion", (0.0, 0.1, 0.0)),),
    digitized=((0.0, 0.1, 0.2),),
    reference=POSE,
    surface=((0.0, 0.0, 0.1),),
    plan=POSE,
    plan_id="plan-1",
    approached=("plan-1", "registration-1"),
    teleoperator="alice",
)
STATES = {"registration": "111", "toolplan": "1", "placement": "placed", "teleoperation": "engaged"}


@pytest.mark.parametrize(
    ("branch", "state", "emptied"),
    [
        ("registration", "000", {"landmarks": (), "digitized": (), "reference": None, "surface": ()}),
        ("registration", "100", {"surface": ()}),
        ("toolplan", "0", {"plan": None, "plan_id": None}),
        ("placement", "retracted", {"approached": None}),
        ("placement", "unknown", {"approached": None}),
        ("teleoperation", "open", {"teleoperator": None}),
    ],
)
def test_each_state_removes_its_data_and_no_other(branch: str, state: str, emptied: dict[str, Any]) -> None:
    assert settle(FULL, STATES, ()) == FULL
    assert settle(FULL, STATES | {branch: state}, ()) == msgspec.structs.replace(FULL, **emptied)


def test_branches_that_a_workflow_lacks_remove_nothing() -> None:
    kept = msgspec.structs.replace(FULL, teleoperator=None)
    assert settle(kept, {"lamp": "on"}, ()) == kept


def test_reinitiated_digitization_keeps_the_planned_landmarks() -> None:
    effect = Effect("reinit", "digitization", "reinit", "1", "0")
    settled = settle(FULL, STATES | {"registration": "100"}, (effect,))
    assert (settled.landmarks, settled.digitized, settled.reference) == (FULL.landmarks, (None,), None)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_a_pose_message_is_the_pose(place: tuple[float, float, float], turn: tuple[float, float, float]) -> None:
    pose = Transform.from_rotvec(place, turn)
    assert as_transform(as_message(pose)).matrix == pytest.approx(pose.matrix, abs=1e-12)
