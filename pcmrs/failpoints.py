"""Failpoints: places in the program at which a test kills the process, to check what a crash there leaves behind."""

from __future__ import annotations

import itertools
import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from pcmrs.errors import ConfigurationError

VARIABLE: Final = "PCMRS_FAILPOINT"
"""Environment variable that arms a failpoint."""

FAILPOINTS: Final = (
    "journal.before_begin",
    "journal.before_commit",
    "journal.after_commit",
    "journal.after_head",
    "journal.before_acknowledge",
    "dispatcher.before_intent",
    "dispatcher.after_intent",
    "dispatcher.before_steps",
    "dispatcher.after_steps",
    "dispatcher.before_outcome",
    "dispatcher.after_outcome",
    "dispatcher.before_reply",
    "service.before_publish",
)
"""Failpoints in the order in which one command with side effects passes them."""

ROTATION_FAILPOINTS: Final = ("journal.before_next_file", "journal.after_next_file", "journal.after_next_head")
"""Failpoints in the order in which a journal that continues in a new file passes them."""

UPGRADE_FAILPOINTS: Final = (
    "upgrade.after_copy",
    "upgrade.after_journal",
    "upgrade.before_exchange",
    "upgrade.after_exchange",
    "upgrade.before_end",
)
"""Failpoints in the order in which the upgrade of a cell's folder passes them."""

_KNOWN: Final = (*FAILPOINTS, *ROTATION_FAILPOINTS, *UPGRADE_FAILPOINTS)


@dataclass(frozen=True, slots=True)
class _Armed:
    name: str
    fatal: int
    passes: Iterator[int] = field(default_factory=lambda: itertools.count(1))


def failpoint(name: str) -> None:
    """Kill the process by SIGKILL if it is armed for this failpoint and this pass; do nothing otherwise."""
    if _armed is not None and _armed.name == name and next(_armed.passes) == _armed.fatal:
        os.kill(os.getpid(), signal.SIGKILL)


def arm(text: str) -> None:
    """Arm this process, like the environment variable PCMRS_FAILPOINT at its start.

    Args:
        text: ``name:N``: the process dies when it passes that failpoint for the N-th time, from 1. Empty disarms.

    Raises:
        ConfigurationError: There is no such failpoint, or N is not a positive integer.
    """
    global _armed
    name, _, count = text.partition(":")
    if text and (name not in _KNOWN or not (count.isascii() and count.isdigit() and int(count))):
        known = ", ".join(_KNOWN)
        raise ConfigurationError(
            f"{VARIABLE}={text} arms nothing: give name:N with N from 1 and one of the names {known}.", value=text
        )
    _armed = _Armed(name, int(count)) if text else None


_armed: _Armed | None = None
arm(os.environ.get(VARIABLE, ""))
