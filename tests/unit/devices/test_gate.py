"""The gate of a device: what still acts after holds, releases and restarts, in any order of arrival."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.gate import ACTS, LATCHED, LATCHING, STALE, Gate
from pcmrs.errors import DeviceError
from pcmrs.messages import ActToken


def token(gate: Gate, number: int = 1, **other: object) -> ActToken:
    """As a daemon makes it that knows the gate as it is now."""
    state = gate.state
    fields = {"daemon": "d", "node": state.node, "epoch": state.epoch, "number": number} | other
    return ActToken(**fields)  # type: ignore[arg-type]


@pytest.fixture
def gate() -> Gate:
    """Of a robot that has been released."""
    made = Gate("robot", "n")
    made.release(token(made))
    return made


def refused(gate: Gate, asked: ActToken | None) -> str:
    with pytest.raises(DeviceError) as failed:
        gate.admit(asked)
    return str(failed.value.fields["code"])


@pytest.mark.parametrize("device", ACTS)
def test_arm_and_stimulator_start_latched_and_pointer_does_not(device: str) -> None:
    made = Gate(device)
    assert made.state.latched == (device in LATCHING) == (device != "pointer")
    if made.state.latched:
        assert refused(made, token(made)) == LATCHED


def test_node_sessions_are_random() -> None:
    assert len({Gate("robot").state.node for _ in range(50)}) == 50


def test_a_request_acts_once_and_none_after_a_newer_one(gate: Gate) -> None:
    first, second = token(gate, 1), token(gate, 2)
    gate.admit(second)
    assert refused(gate, first) == refused(gate, second) == STALE
    gate.admit(token(gate, 3))


@pytest.mark.parametrize("latch", [False, True])
def test_a_request_from_before_a_hold_never_acts_again(gate: Gate, latch: bool) -> None:
    late = token(gate)
    gate.hold(latch=latch)
    assert refused(gate, late) == (LATCHED if latch else STALE)
    if latch:
        gate.release(token(gate))
    assert refused(gate, late) == STALE, "not after the release, either"
    gate.admit(token(gate, 2))


def test_a_hold_that_only_ends_a_motion_keeps_the_latch_as_it_is(gate: Gate) -> None:
    gate.hold(latch=False)
    assert not gate.state.latched
    gate.hold(latch=True)
    gate.hold(latch=False)
    assert gate.state.latched


@pytest.mark.parametrize(
    ("other", "differs"),
    [
        ({"daemon": "earlier"}, ["daemon session"]),
        ({"node": "earlier"}, ["node session"]),
        ({"epoch": 99}, ["epoch"]),
        ({"node": "earlier", "epoch": 99}, ["node session", "epoch"]),
    ],
)
def test_a_request_of_another_session_or_epoch_never_acts(
    gate: Gate, other: dict[str, Any], differs: list[str]
) -> None:
    with pytest.raises(DeviceError) as failed:
        gate.admit(token(gate, 5, **other))
    assert failed.value.fields["code"] == STALE
    assert failed.value.fields["differs"] == differs
    assert " and another ".join(differs) in failed.value.text


def test_a_request_without_a_token_never_acts(gate: Gate) -> None:
    assert refused(gate, None) == STALE


@pytest.mark.parametrize("other", [{"node": "earlier"}, {"epoch": 0}])
def test_release_older_than_a_hold_or_restart_releases_nothing(gate: Gate, other: dict[str, Any]) -> None:
    gate.hold(latch=True)
    with pytest.raises(DeviceError) as failed:
        gate.release(token(gate, **other))
    assert failed.value.fields["code"] == STALE
    assert gate.state.latched


def test_a_release_sets_the_daemon_for_which_the_device_acts(gate: Gate) -> None:
    gate.admit(token(gate, 7))
    gate.hold(latch=True)
    gate.release(token(gate, daemon="e"))
    assert refused(gate, token(gate, 8)) == STALE
    gate.admit(token(gate, 1, daemon="e"))


def test_a_hand_acts_for_the_daemon_that_has_held_it_last() -> None:
    hand = Gate("pointer", "n")
    assert refused(hand, token(hand)) == STALE
    hand.hold(latch=True, daemon="d")
    hand.admit(token(hand))
    late = token(hand, 2)
    hand.hold(latch=False, daemon="e")
    assert refused(hand, late) == STALE


def test_every_hold_and_release_is_a_newer_report(gate: Gate) -> None:
    before = gate.state.changes
    gate.hold(latch=True)
    gate.release(token(gate))
    assert gate.state.changes == before + 2


@given(
    st.lists(
        st.sampled_from(["ask", "ask", "deliver", "hold", "latch", "release", "old release", "new daemon"]),
        max_size=40,
    ),
    st.randoms(use_true_random=False),
)
def test_nothing_requested_before_a_hold_acts_in_any_order(what: list[str], draw: object) -> None:
    """The oracle keeps, for every request on its way, whether a hold, restart or later request has come since."""
    made, daemon = Gate("robot", "n"), 1
    waiting: list[tuple[ActToken, list[bool]]] = []
    releases: list[tuple[ActToken, list[bool]]] = []
    latched = True

    def outdate(entries: list[tuple[ActToken, list[bool]]]) -> None:
        for _, outdated in entries:
            outdated[0] = True

    for number, event in enumerate(what, start=1):
        named = token(made, number, daemon=str(daemon))
        if event == "ask":
            waiting.append((named, [False]))
        elif event == "deliver" and waiting:
            asked, outdated = waiting.pop(draw.randrange(len(waiting)))  # type: ignore[attr-defined]
            if outdated[0] or latched or asked.daemon != made.state.daemon:
                assert refused(made, asked) in (STALE, LATCHED)
            else:
                made.admit(asked)
                outdate([each for each in waiting if each[0].number < asked.number])
        elif event in ("hold", "latch"):
            made.hold(latch=event == "latch")
            latched = latched or event == "latch"
            outdate(waiting)
            outdate(releases)
            releases.append((token(made, number, daemon=str(daemon)), [False]))
        elif event == "release":
            made.release(named)
            latched = False
        elif event == "old release" and releases:
            asked, outdated = releases.pop(draw.randrange(len(releases)))  # type: ignore[attr-defined]
            if outdated[0]:
                with pytest.raises(DeviceError):
                    made.release(asked)
                assert made.state.latched == latched
            else:
                made.release(asked)
                latched = False
        elif event == "new daemon":
            daemon += 1
            made.hold(latch=True)  # as a node does with the first beat of another daemon
            made.forget_daemon()
            latched = True
            outdate(waiting)
            outdate(releases)
        assert made.state.latched == latched
