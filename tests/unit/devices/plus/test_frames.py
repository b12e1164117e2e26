""""""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyigtl.messages import TransformMessage
from scipy.spatial.transform import Rotation

from pcmrs.devices.plus.frames import FrameAssembler
from pcmrs.devices.plus.messages import TrackingDataMessage, matrix_mm, readings, rigid
from pcmrs.errors import RefusalError
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform, distance, rotation_angle
from tests.support import openigtlink_bytes as wire

BODIES = {"CoilToTracker": "coil", "ReferenceToTracker": "body_ref"}

POSE = Transform.from_rotvec([0.1, -0.2, 1.3], [0.3, 0.2, -0.1])

NOW, WALL, LATENCY = 50.0, wire.STAMP + 0.03, 0.02

COIL, BOTH = {"CoilToTracker": POSE}, dict.fromkeys(BODIES, POSE)

finite = st.floats(-1e4, 1e4, width=32)


def frames() -> FrameAssembler:
    return FrameAssembler(BODIES, LATENCY)


def by_body(frame: list[BodyPose]) -> dict[str, BodyPose]:
    return {pose.body: pose for pose in frame}


@given(st.lists(finite, min_size=3, max_size=3), st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3))
def test_a_rigid_matrix_in_single_precision_is_taken(position_mm: list[float], rotvec: list[float]) -> None:
    sent = Transform.from_rotvec(np.array(position_mm) * 1e-3, rotvec)
    taken = rigid(matrix_mm(sent).astype(np.float32))
    assert distance(sent, taken) < 1e-6
    assert rotation_angle(sent, taken) < 1e-6


@given(st.lists(st.floats(width=32), min_size=12, max_size=12))
def test_any_other_matrix_is_refused_with_a_reason(numbers: list[float]) -> None:
    matrix = np.vstack([np.array(numbers).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
    reading = reading_of(matrix)
    if isinstance(reading, str):
        assert reading in ("identity", "not_finite", "not_rigid", "mirrored")
    else:
        np.testing.assert_allclose(reading.rotation, matrix[:3, :3], atol=1e-4)


@given(st.floats(1e-3, 10.0), st.integers(0, 2))
def test_scaled_sheared_and_mirrored_matrices_are_refused(amount: float, axis: int) -> None:
    scaled, sheared, mirrored = matrix_mm(POSE), matrix_mm(POSE), matrix_mm(POSE)
    scaled[:3, :3] *= 1.0 + amount
    sheared[:3, axis] += amount * sheared[:3, (axis + 1) % 3]
    mirrored[:3, axis] *= -1.0
    for matrix, code in ((scaled, "not_rigid"), (sheared, "not_rigid"), (mirrored, "mirrored")):
        with pytest.raises(RefusalError) as refusal:
            rigid(matrix)
        assert refusal.value.refusal_code == code


def reading_of(matrix: Any, metadata: dict[str, str] | None = None) -> Any:
    message = TransformMessage(matrix, device_name="CoilToTracker")
    message.metadata = metadata or {}
    return readings(message)["CoilToTracker"]


def test_tool_reported_missing_or_without_a_pose_is_not_seen() -> None:
    good = matrix_mm(POSE)
    assert isinstance(reading_of(good), Transform)
    assert isinstance(reading_of(good, {"TransformStatus": "OK"}), Transform)
    assert reading_of(good, {"TransformStatus": "MISSING"}) == "missing"
    assert reading_of(good, {"TransformStatus": "TOOL_OUT_OF_VOLUME"}) == "out_of_volume"
    assert reading_of(np.eye(4)) == "identity"
    assert reading_of(good * np.nan) == "not_finite"
    assert reading_of(good * 2.0) == "not_rigid"


def test_tracking_data_has_a_status_for_each_tool() -> None:
    message = TrackingDataMessage({"CoilToTracker": matrix_mm(POSE), "StylusToTracker": matrix_mm(POSE)})
    message.metadata = {"StylusToTrackerStatus": "OUT_OF_VIEW", "CoilToTrackerStatus": "OK"}
    found = readings(message)
    assert isinstance(found["CoilToTracker"], Transform)
    assert found["StylusToTracker"] == "out_of_view"


def test_the_transforms_of_one_stamp_are_one_frame() -> None:
    collected = frames()
    assert collected.take(COIL, wire.STAMP, NOW, WALL) == []
    assert collected.waiting
    (frame,) = collected.take({"ReferenceToTracker": POSE}, wire.STAMP, NOW + 0.001, WALL + 0.001)
    assert not collected.waiting
    coil, reference = by_body(frame)["coil"], by_body(frame)["body_ref"]
    assert coil.frame_number == reference.frame_number == 1
    assert coil.captured == reference.captured == pytest.approx(NOW - 0.03, abs=1e-6)
    assert coil.valid
    assert coil.position == pytest.approx((0.1, -0.2, 1.3))
    assert Rotation.from_quat(coil.quat_wxyz, scalar_first=True).as_rotvec() == pytest.approx([0.3, 0.2, -0.1])


def test_a_body_that_does_not_come_is_not_seen() -> None:
    collected = frames()
    collected.take(COIL, wire.STAMP, NOW, WALL)
    (frame,) = collected.take(COIL, wire.STAMP + 0.016, NOW + 0.016, WALL + 0.016)
    assert (by_body(frame)["body_ref"].valid, by_body(frame)["body_ref"].reason) == (False, "not_sent")
    assert by_body(collected.finish(NOW + 0.02))["coil"].frame_number == 2


def test_a_repeated_or_reversed_stamp_is_no_new_frame() -> None:
    collected = frames()
    assert len(collected.take(BOTH, wire.STAMP, NOW, WALL)) == 1
    for stamp in (wire.STAMP, wire.STAMP - 0.016):
        assert collected.take(BOTH, stamp, NOW + 1.0, WALL + 1.0) == []
    (frame,) = collected.take(BOTH, wire.STAMP + 0.016, NOW + 1.016, WALL + 1.016)
    assert frame[0].frame_number == 2


def test_a_name_of_no_body_makes_no_frame() -> None:
    collected = frames()
    assert collected.take({"ProbeToTracker": POSE}, wire.STAMP, NOW, WALL, whole=True) == []
    assert not collected.waiting


@pytest.mark.parametrize("disagreement", [-3600.0, -0.1, 0.6, 3600.0, math.inf])
def test_frame_is_as_old_as_the_latency_if_the_clocks_disagree(disagreement: float) -> None:
    (frame,) = frames().take(BOTH, wire.STAMP, NOW, wire.STAMP + disagreement)
    assert frame[0].captured == NOW - LATENCY


def test_where_they_agree_a_late_frame_is_old() -> None:
    collected = frames()
    collected.take(BOTH, wire.STAMP, NOW, WALL)
    (late,) = collected.take(BOTH, wire.STAMP + 0.016, NOW + 2.0, WALL + 2.0)
    assert late[0].sent - late[0].captured == pytest.approx(2.0 - 0.016 + 0.03, abs=1e-6)


def test_a_step_of_the_wall_clock_does_not_move_the_frames() -> None:
    collected = frames()
    collected.take(BOTH, wire.STAMP, NOW, WALL)
    (frame,) = collected.take(BOTH, wire.STAMP + 0.016, NOW + 0.016, WALL - 3600.0)
    assert frame[0].captured == pytest.approx(NOW + 0.016 - 0.03, abs=1e-6)


@pytest.mark.parametrize("step", [3600.0, -3600.0, 0.3, -0.3])
def test_stamps_that_are_set_with_the_wall_clock_stay_in_time(step: float) -> None:
    collected = frames()
    collected.take(BOTH, wire.STAMP, NOW, WALL)
    collected.take(COIL, wire.STAMP + 0.016, NOW + 0.016, WALL + 0.016)
    on_the_way, after = collected.take(BOTH, wire.STAMP + 0.032 + step, NOW + 0.032, WALL + 0.032 + step)
    for frame, captured in ((on_the_way, NOW + 0.016 - 0.03), (after, NOW + 0.032 - 0.03)):
        assert by_body(frame)["coil"].valid
        assert frame[0].captured == pytest.approx(captured, abs=1e-6)
    (late,) = collected.take(BOTH, wire.STAMP + 0.048 + step, NOW + 2.0, WALL + 2.0 + step)
    assert late[0].captured == pytest.approx(NOW + 0.048 - 0.03, abs=1e-6)


def test_older_stamp_after_the_wall_clock_was_set_has_no_effect() -> None:
    collected = frames()
    collected.take(BOTH, wire.STAMP, NOW, WALL)
    (before,) = collected.take(BOTH, wire.STAMP + 0.016, NOW + 0.02, WALL + 3600.02)
    (after,) = collected.take(BOTH, wire.STAMP + 3600.032, NOW + 0.04, WALL + 3600.04)
    assert before[0].captured == pytest.approx(NOW + 0.016 - 0.03, abs=1e-6)
    assert after[0].captured == pytest.approx(NOW + 0.032 - 0.03, abs=1e-6)


def test_frame_numbers_continue_over_another_connection() -> None:
    collected = frames()
    collected.take(BOTH, wire.STAMP, NOW, WALL)
    collected.take(COIL, wire.STAMP + 0.1, NOW, WALL)
    collected.restart()
    assert not collected.waiting
    (frame,) = collected.take(BOTH, wire.STAMP - 10.0, NOW, WALL)
    assert frame[0].frame_number == 2
