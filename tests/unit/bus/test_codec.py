"""Codec: what is packed comes back, and other bytes are refused with a reason."""

from collections.abc import Callable
from contextlib import suppress

import msgpack
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.bus.codec import MAX_DEPTH, Empty, error_from, is_text, pack, pack_text, reason_from, unpack
from pcmrs.bus.commands import Envelope
from pcmrs.errors import DeviceError, PayloadError, RefusalError, UnknownOutcomeError
from pcmrs.messages import BodyPose, JointState, Message, Reason, Verdict

finite = st.floats(allow_nan=False, allow_infinity=False)

integers = st.integers(-(2**63), 2**63 - 1)

plain = st.recursive(
    st.none() | st.booleans() | integers | finite | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)

fields = st.dictionaries(st.text(), plain, max_size=4)

reasons = st.builds(Reason, code=st.text(), text=st.text(), fields=fields)

triples = st.tuples(finite, finite, finite)

messages: st.SearchStrategy[Message] = st.one_of(
    st.builds(
        Verdict,
        id=st.text(),
        branch=st.text(),
        operation=st.text(),
        decision=st.sampled_from(["accepted", "rejected", "failed", "unknown"]),
        state=st.text(),
        sequence=integers,
        reason=st.none() | reasons,
        allowed=st.lists(st.text()),
        result=st.none() | fields,
    ),
    st.builds(
        BodyPose,
        body=st.text(),
        frame_number=integers,
        captured=finite,
        sent=finite,
        valid=st.booleans(),
        position=triples,
        quat_wxyz=st.tuples(finite, finite, finite, finite),
    ),
    st.builds(
        JointState,
        captured=finite,
        sent=finite,
        positions=st.lists(finite),
        velocities=st.lists(finite),
        torques=st.lists(finite),
    ),
    st.builds(Envelope, id=st.none() | st.text(min_size=1, max_size=128), sent=st.none() | finite, arguments=fields),
)


@given(messages)
def test_messages_survive_messagepack(message: Message) -> None:
    assert unpack(pack(message), type(message)) == message


@given(messages)
def test_messages_survive_json_text(message: Message) -> None:
    assert unpack(pack_text(message), type(message)) == message


@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_arbitrary_bytes_give_a_message_or_a_payload_error(payload: bytes) -> None:
    for kind in (Envelope, Verdict, dict):
        with suppress(PayloadError):
            assert isinstance(unpack(payload, kind), kind)


@given(messages, st.data())
def test_a_cut_message_is_refused(message: Message, data: st.DataObject) -> None:
    whole = pack(message)
    cut = data.draw(st.integers(1, len(whole) - 1)) if len(whole) > 1 else 0
    if cut:
        with pytest.raises(PayloadError):
            unpack(whole[:cut], type(message))


@pytest.mark.parametrize("payload", [b"", b"  \n", b"{}", b"\x80"])
def test_no_payload_is_no_arguments(payload: bytes) -> None:
    assert unpack(payload, Envelope) == Envelope()
    assert unpack(payload, Empty) == Empty()


def test_first_byte_distinguishes_text_from_messagepack() -> None:
    assert is_text(b' \t{"id": "a"}')
    assert is_text(b"")
    assert not is_text(pack(Envelope(id="a")))
    assert unpack(b' {"id": "a", "arguments": {"index": 3}}', Envelope) == Envelope(id="a", arguments={"index": 3})


def nested(depth: int) -> dict[str, object]:
    """An envelope's fields with a number that lies in `depth` lists and maps."""
    value: object = 1
    for _ in range(depth - 2):
        value = [value]
    return {"arguments": {"a": value}}


@pytest.mark.parametrize("encode", [msgpack.packb, msgspec.json.encode])
def test_nesting_is_limited_in_both_encodings(encode: Callable[[object], bytes]) -> None:
    assert unpack(encode(nested(MAX_DEPTH)), Envelope).arguments == nested(MAX_DEPTH)["arguments"]
    for depth in (MAX_DEPTH + 1, 250, 500):
        with pytest.raises(PayloadError, match=f"nested in more than {MAX_DEPTH} lists and maps"):
            unpack(encode(nested(depth)), Envelope)


@pytest.mark.parametrize("encode", [msgpack.packb, msgspec.json.encode])
@given(depth=st.integers(MAX_DEPTH + 1, 5000))
def test_no_nesting_ends_in_anything_but_a_payload_error(encode: Callable[[object], bytes], depth: int) -> None:
    opening, closing = (b"[", b"]") if encode is msgspec.json.encode else (b"\x91", b"")
    payload = encode({"arguments": {"a": 1}}).replace(encode(1), opening * depth + encode(1) + closing * depth)
    with pytest.raises(PayloadError):
        unpack(payload, Envelope)


def test_the_limit_of_commands_does_not_bind_other_messages() -> None:
    long = JointState(captured=0.0, sent=0.0, positions=[0.5] * 20000, velocities=[], torques=[])
    assert unpack(pack(long), JointState) == long


@pytest.mark.parametrize("value", [object(), {1, 2}.__class__, 2**70, [b"raw", object()]])
def test_value_that_is_not_plain_data_cannot_be_packed(value: object) -> None:
    with pytest.raises(PayloadError, match="cannot be sent"):
        pack(Envelope(arguments={"value": value}))


def test_a_refusal_crosses_with_its_code_and_values() -> None:
    error = error_from(pack(reason_from(RefusalError("residual_too_large", "5 mm are too much.", residual=0.005))))
    assert isinstance(error, DeviceError)
    assert error.text == "5 mm are too much."
    assert error.fields == {"reason": "residual_too_large", "values": {"residual": 0.005}}


@pytest.mark.parametrize("payload", [pack(reason_from(UnknownOutcomeError("Silent."))), b"Timeout", b"\xff"])
def test_unknown_outcome_of_the_other_side_stays_unknown(payload: bytes) -> None:
    assert isinstance(error_from(payload), UnknownOutcomeError)


@pytest.mark.parametrize("code", ["device_failed", UnknownOutcomeError.code])
def test_an_error_reply_without_a_text_still_says_something(code: str) -> None:
    error = error_from(pack(Reason(code=code, text="")))
    assert isinstance(error, UnknownOutcomeError) is (code == UnknownOutcomeError.code)
    assert f"failed ({code})" in error.text
    assert "failed (no code)" in error_from(pack(Reason(code="", text=""))).text
