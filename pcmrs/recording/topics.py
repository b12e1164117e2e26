"""Key expressions of the topics that are recorded or played."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Final

import zenoh

from pcmrs.errors import ConfigurationError

TOPICS: Final = (
    "state/fsm",
    "state/flags",
    "state/event",
    "state/joints",
    "state/robot",
    "state/pose/*",
    "state/target",
    "state/data",
    "state/epoch",
    "state/health",
    "dev/*/state",
    "dev/*/event",
    "daemon/event",
    "dev/*/setpoint",
    "cmd/**",
    "stop/*",
)
"""All but heartbeats, which are of no use afterwards, and video. Of the commands, only those sent by put; the verdicts
on all commands are on ``state/event``."""


def check_topics(topics: Sequence[str]) -> None:
    """Check key expressions: no two may share a key, since its messages would be recorded twice.

    Raises:
        ConfigurationError: There are none, one is not a key expression, or two overlap; the error names them.
    """
    if not topics:
        raise ConfigurationError("No topics are given: name at least one key expression, such as state/**.")
    expressions = [_expression(topic) for topic in topics]
    for one, other in combinations(expressions, 2):
        if one.intersects(other):
            text = f"The topics {one} and {other} overlap: give one of them, or two without common keys."
            raise ConfigurationError(text, topics=[str(one), str(other)])


class TopicFilter:
    """Filter of relative keys.

    Args:
        topics: Key expressions; empty for all keys.

    Raises:
        ConfigurationError: One is not a key expression.
    """

    def __init__(self, topics: Sequence[str]) -> None:
        self._expressions = [_expression(topic) for topic in topics]
        self._known: dict[str, bool] = {}

    def __call__(self, key: str) -> bool:
        """Return whether one of the expressions includes `key`."""
        if not self._expressions:
            return True
        if key not in self._known:
            self._known[key] = any(expression.includes(zenoh.KeyExpr(key)) for expression in self._expressions)
        return self._known[key]


def _expression(topic: str) -> zenoh.KeyExpr:
    try:
        return zenoh.KeyExpr(topic)
    except zenoh.ZError:
        text = f"'{topic}' is not a key expression: write, for example, state/joints, state/pose/* or state/**."
        raise ConfigurationError(text, topic=topic) from None
