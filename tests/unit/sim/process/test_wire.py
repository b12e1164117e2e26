"""Messages between a node and its simulated world."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.framing import MessageSplitter
from pcmrs.errors import (
    DeviceError,
    DeviceRefusedError,
    PayloadError,
    PcmrsError,
    UnknownOutcomeError,
)
from pcmrs_sim.process.wire import Call, Cancel, Failure, Reply, pack, read_by_node, read_by_world

pytest.importorskip("mujoco")


@pytest.mark.parametrize("kind", [DeviceError, DeviceRefusedError, UnknownOutcomeError, PayloadError])
def test_an_error_crosses_the_link_with_its_code_text_and_fields(kind: type[PcmrsError]) -> None:
    error = Failure.of(kind("The arm moves.", code="moving", limit=0.5)).error()
    assert (type(error), error.code) == (kind, kind.code)
    assert (error.text, error.fields) == ("The arm moves.", {"code": "moving", "limit": 0.5})


def test_a_failure_of_an_unknown_kind_is_an_unknown_outcome() -> None:
    """A world of another version may raise what this node does not know: then nothing is known of the arm."""
    error = Failure("FutureError", "It went wrong.", {"limit": 1}).error()
    assert (type(error), error.text, error.fields) == (UnknownOutcomeError, "It went wrong.", {"limit": 1})


@given(number=st.integers(0, 2**40), value=st.floats(allow_nan=False) | st.text(max_size=20) | st.none())
def test_messages_come_back_from_their_bytes(number: int, value: float | str | None) -> None:
    call = Call(number, "robot", "hold", {"argument": value}, 1.5)
    reply = Reply(number, result=value)
    assert read_by_world(body_of(pack(call))) == call
    assert read_by_node(body_of(pack(reply))) == reply


def test_a_message_for_the_other_end_is_refused() -> None:
    with pytest.raises(msgspec.ValidationError):
        read_by_node(body_of(pack(Cancel(3))))
    with pytest.raises(msgspec.ValidationError):
        read_by_world(body_of(pack(Reply(3))))


def body_of(packed: bytes) -> bytes:
    (body,) = MessageSplitter().feed(packed)
    return body
