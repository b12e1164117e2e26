"""The dispatcher's own events: what is dangerous, who is named, and that their fields survive the journal."""

from __future__ import annotations

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.dispatcher.events import DAEMON, FAIL_STOP, REOPENED, failed, not_confirmed, pressed_again, stopped
from pcmrs.messages import DeviceEvent, Reason

TOO_STRONG = Reason(code="force_limit", text="31 N, limit 30 N.", fields={"force": 31.0, "stop": -1})


def test_event_of_a_stop_has_its_number_beside_the_reason() -> None:
    """The number of the Stop is what an acknowledgement names: no field of the reason may hide it."""
    event = stopped("device:robot", TOO_STRONG, 7)
    assert (event.device, event.code, event.text, event.danger) == (
        "device:robot",
        "force_limit",
        TOO_STRONG.text,
        True,
    )
    assert event.fields == {"force": 31.0, "stop": 7}
    assert TOO_STRONG.fields["stop"] == -1, "the reason is as it was"


def test_failure_names_its_code_and_is_danger() -> None:
    event = failed(TOO_STRONG)
    assert (event.device, event.code, event.danger) == (DAEMON, FAIL_STOP, True)
    assert event.fields == {"reason": "force_limit"}


def test_doubt_and_reopening_are_danger_and_say_look() -> None:
    for event in (not_confirmed("bus:anna"), REOPENED):
        assert event.danger
        assert "look" in event.text


@given(joined=st.dictionaries(st.text(min_size=1), st.integers(1, 10**6), min_size=1), number=st.integers(1, 10**9))
def test_counted_presses_are_no_danger_and_survive_json(joined: dict[str, int], number: int) -> None:
    event = pressed_again("bus:eve", number, joined)
    assert not event.danger, "the Stop that they joined was"
    assert event.fields == {"stop": number, "presses": sum(joined.values()), "by": joined}
    assert f"{sum(joined.values())} more times" in event.text
    assert msgspec.json.decode(msgspec.json.encode(event), type=DeviceEvent) == event
    joined.clear()
    assert event.fields["by"], "later presses of the next Stop do not change it"
