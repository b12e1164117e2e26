"""Quality of service: one table from keys to classes of data, for publishers and subscribers alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from zenoh import KeyExpr, Priority


@dataclass(frozen=True)
class DataClass:
    """How one kind of data travels. A publisher never blocks: when its queue is full, data is dropped.

    Attributes:
        priority: Of the queue in which it waits for the link.
        newest: So many unread messages of one key wait, the newest; 0 where none is dropped for a newer one.
        kept: Messages that the publisher keeps, so that lost ones are recovered; 0 for none.
        history: Kept messages that a late subscriber is given.
        express: Sent at once instead of in a batch.
        urgent: Heard before what else waits, and not turned away because of it.
    """

    priority: Priority
    newest: int
    kept: int = 0
    history: int = 0
    express: bool = False
    urgent: bool = False


COMMANDS: Final = DataClass(Priority.REAL_TIME, newest=0, express=True)
# A sender that blocks holds the queue of its priority: holds must have another one than what they end.
REQUESTS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest=0, express=True)
SNAPSHOTS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest=1, kept=1, history=1)
EVENTS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest=0, kept=256, urgent=True)
# So many signals lie over each other on a display.
EPOCHS: Final = DataClass(Priority.DATA, newest=5, kept=5, history=5)
REPORTS: Final = DataClass(Priority.DATA_LOW, newest=1, kept=1, history=1)
BEATS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest=1, express=True)
SETPOINTS: Final = DataClass(Priority.REAL_TIME, newest=1, express=True)
# A guard that sees every second pose of a body sees nothing of a reflection that moves the others.
POSES: Final = DataClass(Priority.INTERACTIVE_LOW, newest=16)
JOINTS: Final = DataClass(Priority.DATA_HIGH, newest=1)
VIDEO: Final = DataClass(Priority.BACKGROUND, newest=1)
# Copies for ROS 2, behind everything that the cell itself needs.
COPIES: Final = DataClass(Priority.DATA_LOW, newest=16)
COPIED_SNAPSHOTS: Final = DataClass(Priority.DATA_LOW, newest=1, kept=1, history=1)
OTHER: Final = DataClass(Priority.DATA, newest=0)

_TABLE: Final = [
    (KeyExpr(expression), data_class)
    for expression, data_class in (
        ("cmd/**", COMMANDS),
        ("stop/*", COMMANDS),
        ("state/fsm", SNAPSHOTS),
        ("state/flags", SNAPSHOTS),
        ("state/event", EVENTS),
        ("state/joints", JOINTS),
        ("state/robot", JOINTS),
        ("state/pose/*", POSES),
        ("state/target", SNAPSHOTS),
        ("state/data", SNAPSHOTS),
        ("state/epoch", EPOCHS),
        ("state/health", REPORTS),
        ("dev/*/state", SNAPSHOTS),
        ("dev/*/beat", BEATS),
        ("daemon/beat", BEATS),
        ("daemon/event", EVENTS),
        ("dev/*/setpoint", SETPOINTS),
        ("teleop/*", SETPOINTS),
        ("state/teleop", BEATS),
        ("dev/*/event", EVENTS),
        ("video/*", VIDEO),
        ("ros2/tracker/*", POSES),
        ("ros2/state", COPIED_SNAPSHOTS),
        ("ros2/tf_static", COPIED_SNAPSHOTS),
        ("ros2/**", COPIES),
        ("**", OTHER),
    )
]


def class_of(key: str) -> DataClass:
    """The class of all data on a relative key or key expression."""
    asked = KeyExpr(key)
    return next(data_class for expression, data_class in _TABLE if expression.includes(asked))
