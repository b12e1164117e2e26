"""A heartbeat of a node counts from the time at which it was sent."""

from __future__ import annotations

import pytest

from pcmrs.messages import GateState, NodeBeat
from pcmrs.service.watches.beats import NodeBeats

OFFSET = 1000.0
"""Of the node's clock."""
PERIOD = 0.025


def beat(number: int, sent: float, session: str | None = "a") -> NodeBeat:
    gate = GateState(node=session, epoch=0, latched=False) if session is not None else None
    return NodeBeat(number=number, sent=sent + OFFSET, gate=gate)


def heard(session: str | None = "a") -> NodeBeats:
    """The heartbeats of one second, without delay."""
    beats = NodeBeats()
    for number in range(1, 41):
        assert beats.take(beat(number, number * PERIOD, session), number * PERIOD) == pytest.approx(number * PERIOD)
    return beats


def test_a_delayed_heartbeat_is_as_old_as_it_is() -> None:
    beats = heard()
    assert beats.take(beat(41, 1.025), 6.0) == pytest.approx(1.025)
    assert beats.take(beat(42, 6.0), 6.0) == pytest.approx(6.0)


def test_heartbeats_overtaken_or_stamped_ahead_do_not_count() -> None:
    beats = heard()
    assert beats.take(beat(39, 1.1), 1.1) == pytest.approx(1.0)
    assert beats.take(beat(41, 1e6), 1.2) == pytest.approx(1.0)
    assert beats.take(beat(42, 1.3), 1.3) == pytest.approx(1.3)


@pytest.mark.parametrize(("before", "after"), [("a", "b"), (None, None)])
def test_a_node_that_has_restarted_may_have_another_clock(before: str | None, after: str | None) -> None:
    """Its numbers restart, too, and only a device that acts has a session."""
    beats = heard(before)
    assert beats.take(beat(1, -OFFSET, after), 3.0) == pytest.approx(3.0)
    assert beats.take(beat(2, PERIOD - OFFSET, after), 5.0) == pytest.approx(3.0 + PERIOD)


def test_first_heartbeat_is_a_sign_of_life_of_now() -> None:
    assert NodeBeats().take(beat(7, 0.0), 9.0) == pytest.approx(9.0)
