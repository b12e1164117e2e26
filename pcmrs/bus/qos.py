"""Quality of service: one table from keys to classes of data, for publishers and subscribers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from zenoh import KeyExpr, Priority


@dataclass(frozen=True)
class DataClass:
    """Transport of one kind of data. A publisher never blocks: if its queue is full, data is dropped.

    Attributes:
        priority: Priority of the queue in which it waits for the link.
        newest: Number of unread messages of one key that wait for the receiver; older ones are dropped. 0: a newer
            message never replaces an older one.
        kept: Number of messages that the publisher keeps, so that lost ones are recovered; 0 for none.
        history: Number of kept messages that a late subscriber receives.
        express: True to send at once instead of in a batch.
        urgent: True to handle it before other waiting messages, in its own queue.
    """

    priority: Priority
    newest: int
    kept: int = 0
    history: int = 0
    express: bool = False
    urgent: bool = False


COMMANDS: Final = DataClass(Priority.REAL_TIME, newest=0, express=True)
# A sender that blocks also blocks the queue of its priority, so requests and the holds that end them need two queues.
REQUESTS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest=0, express=True)
SNAPSHOTS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest=1, kept=1, history=1)
EVENTS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest=0, kept=256, urgent=True)
# A display overlays this many signals.
EPOCHS: Final = DataClass(Priority.DATA, newest=5, kept=5, history=5)
REPORTS: Final = DataClass(Priority.DATA_LOW, newest=1, kept=1, history=1)
BEATS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest=1, express=True)
SETPOINTS: Final = DataClass(Priority.REAL_TIME, newest=1, express=True)
# The jump guard needs every pose: it misses a reflection if it sees only every second pose.
POSES: Final = DataClass(Priority.INTERACTIVE_LOW, newest=16)
JOINTS: Final = DataClass(Priority.DATA_HIGH, newest=1)
VIDEO: Final = DataClass(Priority.BACKGROUND, newest=1)
# Room for all detections in some frames; a flood replaces its own events, and counts as the loss of its source.
SCENE_EVENTS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest=64, express=True)
# Copies for ROS 2 have a lower priority than everything that the cell itself needs.
COPIES: Final = DataClass(Priority.DATA_LOW, newest=16)
COPIED_SNAPSHOTS: Final = DataClass(Priority.DATA_LOW, newest=1, kept=1, history=1)
# Text for people and scripts: no message replaces another, and none delays the cell.
TEXT: Final = DataClass(Priority.DATA_LOW, newest=0)
OTHER: Final = DataClass(Priority.DATA, newest=0)

_TABLE: Final = [
    (KeyExpr(expression), data_class)
    for expression, data_class in (
        ("cmd/**", COMMANDS),
        ("stop/*", COMMANDS),
        ("state/fsm", SNAPSHOTS),
        ("state/flags", SNAPSHOTS),
        ("state/event", EVENTS),
        ("json/**", TEXT),
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
        ("scene/*", SCENE_EVENTS),
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
    """Return the class of the data on a relative key or key expression."""
    requested = KeyExpr(key)
    return next(data_class for expression, data_class in _TABLE if expression.includes(requested))
