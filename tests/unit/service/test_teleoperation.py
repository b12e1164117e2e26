"""Set points count for the user that their key names, and hands that guide the tool are noticed."""

from __future__ import annotations

import msgspec

from pcmrs.messages import TeleopSetpoint, TeleopStatus
from pcmrs.service._teleoperation import SETPOINTS, STATUS, connect_teleoperators
from pcmrs.workflows.teleop_port import TeleopPort
from tests.support.memory_link import MemoryLink

SETPOINT = TeleopSetpoint(sequence=1, sent=5.0, seen=4.9, ttl=0.2, twist=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


class Link(MemoryLink):
    """A bus that matches the one expression that is used here."""

    def hear(self, key: str, message: msgspec.Struct) -> None:
        assert key.startswith("teleop/")
        for handler in self._subscribers[SETPOINTS]:
            handler(key, message)


def test_a_set_point_is_its_keys_and_goes_to_who_guides_now() -> None:
    link, port = Link(), TeleopPort()
    connect_teleoperators(link, port, lambda: None)
    received: list[tuple[str, int]] = []
    link.hear("teleop/early", SETPOINT)
    with port.deliver_to(lambda user, setpoint: received.append((user, setpoint.sequence))):
        link.hear("teleop/anna", SETPOINT)
        link.hear("teleop/bob", SETPOINT)
    link.hear("teleop/late", SETPOINT)
    assert received == [("anna", 1), ("bob", 1)]


def test_statuses_are_published_and_only_hands_count_as_seen() -> None:
    """A status without a set point is sent while nobody guides: it must not keep an abandoned session alive."""
    link, port = Link(), TeleopPort()
    seen: list[None] = []
    connect_teleoperators(link, port, lambda: seen.append(None))
    idle, guided = TeleopStatus(stamp=1.0), TeleopStatus(stamp=2.0, user="anna", sequence=7)
    port.publish(idle)
    assert seen == []
    port.publish(guided)
    assert seen == [None]
    assert link.published[STATUS] == [idle, guided]
