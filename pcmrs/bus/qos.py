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
        newest_only: An unread message is replaced by the next one of the same key.
        kept: Messages that the publisher keeps, so that lost ones are recovered; 0 for none.
        history: Kept messages that a late subscriber is given.
        express: Sent at once instead of in a batch.
        urgent: Heard before what else waits, and not turned away because of it.
    """

    priority: Priority
    newest_only: bool
    kept: int = 0
    history: int = 0
    express: bool = False
    urgent: bool = False


COMMANDS: Final = DataClass(Priority.REAL_TIME, newest_only=False, express=True)
SNAPSHOTS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest_only=True, kept=1, history=1)
EVENTS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest_only=False, kept=256, urgent=True)
BEATS: Final = DataClass(Priority.INTERACTIVE_HIGH, newest_only=True, express=True)
SETPOINTS: Final = DataClass(Priority.REAL_TIME, newest_only=True, express=True)
POSES: Final = DataClass(Priority.INTERACTIVE_LOW, newest_only=True)
JOINTS: Final = DataClass(Priority.DATA_HIGH, newest_only=True)
VIDEO: Final = DataClass(Priority.BACKGROUND, newest_only=True)
OTHER: Final = DataClass(Priority.DATA, newest_only=False)

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
        ("dev/*/state", SNAPSHOTS),
        ("dev/*/beat", BEATS),
        ("dev/*/setpoint", SETPOINTS),
        ("dev/*/event", EVENTS),
        ("video/*", VIDEO),
        ("**", OTHER),
    )
]


def class_of(key: str) -> DataClass:
    """The class of all data on a relative key or key expression."""
    asked = KeyExpr(key)
    return next(data_class for expression, data_class in _TABLE if expression.includes(asked))
