"""Places in the program at which a test has its process killed, to see what a crash there leaves behind."""

from __future__ import annotations

import itertools
import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from pcmrs.errors import ConfigurationError

VARIABLE: Final = "PCMRS_FAILPOINT"

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
"""In the order in which one command that touches the world passes them."""

ROTATION_FAILPOINTS: Final = ("journal.before_next_file", "journal.after_next_file", "journal.after_next_head")
"""In the order in which a journal that goes on in a new file passes them."""


@dataclass(frozen=True, slots=True)
class _Armed:
    name: str
    fatal: int
    passes: Iterator[int] = field(default_factory=lambda: itertools.count(1))


def failpoint(name: str) -> None:
    """Do nothing, unless this is the place and the time that the process was armed for: then it dies by SIGKILL."""
    if _armed is not None and _armed.name == name and next(_armed.passes) == _armed.fatal:
        os.kill(os.getpid(), signal.SIGKILL)


def arm(text: str) -> None:
    """Arm this process, as its environment variable PCMRS_FAILPOINT does when it starts.

    Args:
        text: ``name:N``: dies when it reaches that place for the N-th time, from 1; empty disarms.

    Raises:
        ConfigurationError: There is no such place, or N is no count.
    """
    global _armed
    name, _, count = text.partition(":")
    if text and (
        name not in FAILPOINTS + ROTATION_FAILPOINTS or not (count.isascii() and count.isdigit() and int(count))
    ):
        known = ", ".join(FAILPOINTS + ROTATION_FAILPOINTS)
        raise ConfigurationError(
            f"{VARIABLE}={text} arms nothing: give name:N with N from 1 and one of the names {known}.", value=text
        )
    _armed = _Armed(name, int(count)) if text else None


_armed: _Armed | None = None
arm(os.environ.get(VARIABLE, ""))
