"""Decoding in one step: the same messages as step by step, and nothing that the steps refuse."""

from __future__ import annotations

import math
from typing import Any

import msgpack
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.bus._closed_decoder import closed_decoder
from pcmrs.messages import Beat, BodyPose, JointSetpoint, JointState, Reason, SceneTruth, TeleopSetpoint, Verdict

STREAMED = (BodyPose, JointState, JointSetpoint, Beat, TeleopSetpoint, SceneTruth)

numbers = st.integers(-(2**63), 2**64 - 1) | st.floats()
scalars = numbers | st.none() | st.booleans() | st.text(max_size=3) | st.binary(max_size=3)
values = scalars | st.lists(numbers, max_size=8) | st.lists(scalars, max_size=4)


def _is_plain(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    if isinstance(value, msgspec.Struct):
        return _is_plain(msgspec.structs.astuple(value))
    if isinstance(value, float):
        return math.isfinite(value)
    return not isinstance(value, int) or -(2**63) <= value < 2**63


def _step_by_step(payload: bytes, kind: Any) -> Any:
    try:
        message = msgspec.convert(msgpack.unpackb(payload), kind)
    except msgspec.ValidationError:
        return None
    return message if _is_plain(message) else None


@pytest.mark.parametrize("kind", STREAMED)
@given(data=st.data())
def test_what_is_decoded_at_once_is_the_same_step_by_step(kind: type[msgspec.Struct], data: st.DataObject) -> None:
    """For messages of which some fields are replaced by any value, and some are added."""
    pose = {"position": [0.0, 0.1, 0.2], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]}
    whole: dict[str, Any] = {
        "body": "coil",
        "frame_number": 7,
        "captured": 1.5,
        "sent": 1.6,
        "valid": True,
        **pose,
        "positions": [0.1] * 7,
        "velocities": [0.1] * 7,
        "torques": [0.1] * 7,
        "number": 3,
        "session": "s",
        "alive": 1.4,
        "tracker_from_coil": pose,
        "tracker_from_body_ref": pose,
        "body_ref_from_image": pose,
        "tip_in_tracker": None,
    }
    names = st.sampled_from([*(field.encode_name for field in msgspec.structs.fields(kind)), "added"])
    fields = whole | data.draw(st.dictionaries(names, values, max_size=3))
    payload = msgpack.packb(fields)
    decode = closed_decoder(kind)
    assert decode is not None
    assert decode(payload) == _step_by_step(payload, kind)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["captured", "position", "quat_wxyz", "error"])
def test_number_that_is_not_finite_is_not_decoded(field: str, number: float) -> None:
    pose = {"body": "coil", "frame_number": 1, "captured": 1.0, "sent": 1.0, "valid": True}
    wrong = {"position": [0.0, 0.0, number], "quat_wxyz": [1.0, number, 0.0, 0.0]}.get(field, number)
    decode = closed_decoder(BodyPose)
    assert decode is not None
    assert decode(msgpack.packb(pose)) == BodyPose(**pose)  # type: ignore[arg-type]
    assert decode(msgpack.packb(pose | {field: wrong})) is None


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"\x91" * 5000, b"\x81\xa1x" + b"\x91" * 5000, b"\x85\xa4body"])
def test_bytes_that_are_no_message_are_not_decoded(payload: bytes) -> None:
    decode = closed_decoder(BodyPose)
    assert decode is not None
    assert decode(payload) is None


@pytest.mark.parametrize("kind", [Verdict, Reason, dict, Any])
def test_type_that_may_hold_any_data_has_no_decoder(kind: Any) -> None:
    assert closed_decoder(kind) is None
