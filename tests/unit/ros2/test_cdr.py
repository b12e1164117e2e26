"""Messages of ROS 2 as bytes: as the specification has them, and back."""

from __future__ import annotations

import math
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import PayloadError
from pcmrs.ros2 import cdr
from pcmrs.spatial import Transform
from tests.unit.ros2 import cdr_bytes

doubles = st.floats(allow_nan=False)
texts = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=40)
seconds = st.integers(-(2**31), 2**31 - 1)
nanoseconds = st.integers(0, 10**9 - 1)
headers = st.builds(cdr.Header, st.builds(cdr.Time, seconds, nanoseconds), texts)
quaternions = st.builds(cdr.Quaternion, doubles, doubles, doubles, doubles)
points = st.builds(cdr.Point, doubles, doubles, doubles)
poses = st.builds(cdr.PoseStamped, headers, st.builds(cdr.Pose, points, quaternions))
moved = st.builds(cdr.RigidTransform, st.builds(cdr.Vector3, doubles, doubles, doubles), quaternions)
links = st.builds(cdr.TransformStamped, headers, texts, moved)
numbers = st.lists(doubles, max_size=8)


def four(turn: cdr.Quaternion) -> tuple[float, float, float, float]:
    return turn.x, turn.y, turn.z, turn.w


def test_a_pose_is_the_bytes_that_are_written_down() -> None:
    """Counted out by hand, byte by byte, with a frame whose length asks for padding before the first number."""
    pose = Transform.from_quat_xyzw([1.0, -2.0, 0.5], [1.0, 0.0, 0.0, 0.0])
    expected = (
        "00010000"  # plain CDR, little-endian; no options
        "01000000 0065cd1d"  # sec 1; nanosec 500000000
        "08000000 747261636b657200"  # 8 letters: tracker, zero
        "00000000"  # to 24, the next multiple of 8
        "000000000000f03f 00000000000000c0 000000000000e03f"  # 1, -2, 0.5
        "000000000000f03f 0000000000000000 0000000000000000 0000000000000000"  # x y z w
    )
    message = cdr.pose_stamped("tracker", pose, 1.5)
    assert message.serialize() == bytes.fromhex(expected)


@given(poses)
def test_poses(message: cdr.PoseStamped) -> None:
    stamp, at, turn = message.header.stamp, message.pose.position, four(message.pose.orientation)
    by_hand = cdr_bytes.pose_stamped(stamp.sec, stamp.nanosec, message.header.frame_id, (at.x, at.y, at.z), turn)
    assert message.serialize() == by_hand
    assert cdr.decode(by_hand, cdr.PoseStamped) == message


@given(headers, st.lists(texts, max_size=8), numbers, numbers, numbers)
def test_joints(head: cdr.Header, names: list[str], at: list[float], speed: list[float], effort: list[float]) -> None:
    message = cdr.RosJointState(head, names, at, speed, effort)
    by_hand = cdr_bytes.joint_state(head.stamp.sec, head.stamp.nanosec, head.frame_id, names, at, speed, effort)
    assert message.serialize() == by_hand
    assert cdr.RosJointState.deserialize(by_hand) == message


@given(st.lists(links, max_size=4))
def test_frames(shown: list[cdr.TransformStamped]) -> None:
    plain = [
        (
            each.header.stamp.sec,
            each.header.stamp.nanosec,
            each.header.frame_id,
            each.child_frame_id,
            (each.transform.translation.x, each.transform.translation.y, each.transform.translation.z),
            four(each.transform.rotation),
        )
        for each in shown
    ]
    message = cdr.TFMessage(shown)
    assert message.serialize() == cdr_bytes.tf(plain)
    assert cdr.TFMessage.deserialize(cdr_bytes.tf(plain)) == message


@given(texts)
def test_text(text: str) -> None:
    assert cdr.String(text).serialize() == cdr_bytes.string(text)


@given(st.floats(0.0, 2.0**31 - 1.0))
def test_a_stamp_is_within_a_nanosecond_and_its_parts_in_range(at: float) -> None:
    stamp = cdr.header("", at).stamp
    assert 0 <= stamp.nanosec < 10**9
    assert math.isclose(stamp.sec + stamp.nanosec * 1e-9, at, abs_tol=1.1e-9, rel_tol=1e-15)


@given(st.binary(max_size=200) | poses.map(lambda pose: pose.serialize()), st.data())
def test_other_bytes_are_refused_and_do_nothing_else(payload: bytes, data: st.DataObject) -> None:
    """Cut off, with bytes changed, or nothing of the kind: a pose or `PayloadError`."""
    damaged = bytearray(payload[: data.draw(st.integers(0, len(payload)))])
    for place in data.draw(st.lists(st.integers(0, max(0, len(damaged) - 1)), max_size=3)) if damaged else ():
        damaged[place] ^= data.draw(st.integers(1, 255))
    with suppress(PayloadError):
        assert isinstance(cdr.decode(bytes(damaged), cdr.PoseStamped), cdr.PoseStamped)


@given(poses)
def test_a_pose_with_covariance_is_no_pose(message: cdr.PoseStamped) -> None:
    with pytest.raises(PayloadError, match="288 bytes are left over"):
        cdr.decode(message.serialize() + bytes(36 * 8), cdr.PoseStamped)


def test_a_flood_is_refused_before_it_is_read() -> None:
    with pytest.raises(PayloadError, match="too long"):
        cdr.decode(b"\x00\x01\x00\x00" + bytes(cdr.MAX_BYTES), cdr.PoseStamped)
