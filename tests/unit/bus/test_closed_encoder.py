"""Messages of closed types are encoded in one step, to the bytes of the two steps of all others."""

from __future__ import annotations

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.bus._closed_encoder import is_closed
from pcmrs.bus.codec import pack
from pcmrs.errors import PayloadError
from pcmrs.messages import Beat, BodyPose, DeviceEvent, JointState, Message, PoseMessage, Target, Verdict

numbers = st.floats() | st.integers(-(2**63), 2**64 - 1)
"""Also those that a receiver refuses: the bytes must not depend on it."""
poses = st.builds(
    PoseMessage, position=st.tuples(numbers, numbers, numbers), quat_wxyz=st.tuples(numbers, numbers, numbers, numbers)
)
closed: st.SearchStrategy[Message] = st.one_of(
    poses,
    st.builds(
        BodyPose,
        body=st.text(),
        frame_number=st.integers(-(2**63), 2**64 - 1),
        captured=numbers,
        sent=numbers,
        valid=st.booleans(),
        position=st.tuples(numbers, numbers, numbers),
        quat_wxyz=st.tuples(numbers, numbers, numbers, numbers),
    ),
    st.builds(
        JointState,
        captured=numbers,
        sent=numbers,
        positions=st.lists(numbers),
        velocities=st.lists(numbers),
        torques=st.lists(numbers),
        moving=st.booleans(),
    ),
    st.builds(Beat, number=st.integers(0, 2**64 - 1), session=st.text(), alive=numbers, sent=numbers),
    st.builds(Target, plan=st.text(), pose=st.none() | poses, body_ref_from_image=st.none() | poses),
)


@given(closed)
def test_bytes_are_those_of_plain_data(message: Message) -> None:
    assert is_closed(type(message))
    assert pack(message) == msgpack.packb(msgspec.to_builtins(message))


@pytest.mark.parametrize("kind", [DeviceEvent, Verdict, dict])
def test_type_that_may_hold_any_data_is_not_closed(kind: type) -> None:
    assert not is_closed(kind)


@pytest.mark.parametrize("value", [np.zeros(3), [2**64], [object()], ["\ud800"]])
def test_value_that_cannot_be_sent_is_refused(value: object) -> None:
    with pytest.raises(PayloadError, match="A JointState cannot be sent"):
        pack(JointState(captured=0.0, sent=0.0, positions=value, velocities=[], torques=[]))  # type: ignore[arg-type]
