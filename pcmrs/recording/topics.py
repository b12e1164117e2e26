"""Which keys of a cell are recorded or played, as key expressions."""

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
"""All but heartbeats, which say nothing afterwards, and video. Of the commands, those that were put; the verdicts of
all are on ``state/event``."""


def check_topics(topics: Sequence[str]) -> None:
    """Accept key expressions of which no two share a key: what both match would be recorded twice.

    Raises:
        ConfigurationError: One is no key expression, there are none, or two overlap; they are named.
    """
    if not topics:
        raise ConfigurationError("No topics are given: name at least one key expression, such as state/**.")
    expressions = [_expression(topic) for topic in topics]
    for one, other in combinations(expressions, 2):
        if one.intersects(other):
            text = f"The topics {one} and {other} overlap: give one of them, or two without common keys."
            raise ConfigurationError(text, topics=[str(one), str(other)])


class TopicFilter:
    """Says whether a relative key is asked for.

    Args:
        topics: Key expressions; none for all keys.

    Raises:
        ConfigurationError: One is no key expression.
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
        text = f"'{topic}' is no key expression: write such as state/joints, state/pose/* or state/**."
        raise ConfigurationError(text, topic=topic) from None
