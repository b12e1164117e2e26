"""The class of data of each key."""

from __future__ import annotations

import pytest

from pcmrs.bus.qos import (
    BEATS,
    COMMANDS,
    EVENTS,
    JOINTS,
    OTHER,
    POSES,
    REQUESTS,
    SETPOINTS,
    SNAPSHOTS,
    DataClass,
    class_of,
)


@pytest.mark.parametrize(
    ("key", "data"),
    [
        ("cmd/local/robot/connect", COMMANDS),
        ("cmd/*/*/*", COMMANDS),
        ("stop/*", COMMANDS),
        ("state/fsm", SNAPSHOTS),
        ("state/event", EVENTS),
        ("state/joints", JOINTS),
        ("state/pose/coil", POSES),
        ("state/pose/*", POSES),
        ("dev/robot/beat", BEATS),
        ("dev/*/beat", BEATS),
        ("dev/robot/setpoint", SETPOINTS),
        ("dev/robot/event", EVENTS),
        ("dev/robot/state", SNAPSHOTS),
        ("meta/version", OTHER),
        ("state/**", OTHER),
    ],
)
def test_each_key_has_its_class_of_data(key: str, data: DataClass) -> None:
    assert class_of(key) is data


def test_holds_have_a_queue_of_the_link_to_themselves() -> None:
    assert COMMANDS.priority != REQUESTS.priority
