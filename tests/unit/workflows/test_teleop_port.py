"""Set points reach the activity that guides the tool, and nobody before or after it."""

from __future__ import annotations

import pytest

from pcmrs.messages import TeleopSetpoint
from pcmrs.messages.teleop import AT_REST
from pcmrs.workflows.teleop_port import TeleopPort


def setpoint(sequence: int) -> TeleopSetpoint:
    return TeleopSetpoint(sequence=sequence, sent=0.0, seen=0.0, ttl=1.0, twist=AT_REST)


def test_set_points_are_delivered_only_while_the_tool_is_guided() -> None:
    port, taken = TeleopPort(), list[tuple[str, int]]()
    port.receive("alice", setpoint(1))
    with port.deliver_to(lambda user, received: taken.append((user, received.sequence))):
        port.receive("alice", setpoint(2))
        port.receive("bob", setpoint(3))
    port.receive("alice", setpoint(4))
    assert taken == [("alice", 2), ("bob", 3)]


def test_guidance_that_fails_receives_nothing_afterwards() -> None:
    port, taken = TeleopPort(), list[int]()
    with pytest.raises(RuntimeError), port.deliver_to(lambda _, received: taken.append(received.sequence)):
        raise RuntimeError
    port.receive("alice", setpoint(1))
    assert taken == []
