"""Record of the attacks of a row: on which entry points of a cell, by which attackers.

A row declares them (`pcmrs_lab.campaign.fault.fault`), the code that sends records them, and `pcmrs faults run`
compares both, so that the table of attacks in docs/threat-model.md has none that did not take place.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final, NamedTuple

from pcmrs_lab.campaign.sham import is_sham

COMMANDS: Final = "commands on the bus"
STOP: Final = "Stop on the bus"
SETPOINTS: Final = "set points on the bus"
SCENE_EVENTS: Final = "scene events on the bus"
QUERIES: Final = "queries on the bus"
DEVICES: Final = "keys of devices"
STREAMS: Final = "streams"
ROS_POSES: Final = "poses of ROS 2"
WILDCARDS: Final = "keys with wildcards"
ADMIN: Final = "admin space"
BUS: Final = (COMMANDS, STOP, SETPOINTS, SCENE_EVENTS, QUERIES, DEVICES, STREAMS)
"""Keys of a cell that members use."""
FILES: Final = "keys and settings"

UNKNOWN: Final = "unknown client"
DELAYED: Final = "delayed message"
FLOODING: Final = "flood"
LOCAL_ACCOUNT: Final = "local account"

_FIRST: Final = {
    "cmd": COMMANDS, "stop": STOP, "teleop": SETPOINTS, "svc": QUERIES, "dev": DEVICES, "daemon": DEVICES,
    "scene": SCENE_EVENTS, "state": STREAMS, "json": STREAMS, "ros2": STREAMS, "@": ADMIN,
}  # fmt: skip
_CELL_PARTS: Final = 3
"""Number of chunks of an absolute key before the relative key: ``pcmrs/<site>/<cell>``."""


class Try(NamedTuple):
    """One kind of attack.

    Attributes:
        way: Entry point of a cell, of the list ``ways`` in ``attacks.toml``.
        by: Attacker, of the list ``attackers`` there.
    """

    way: str
    by: str


_recorded: ContextVar[set[Try] | None] = ContextVar("tries", default=None)


@contextmanager
def recorded_tries() -> Iterator[set[Try]]:
    """Record what is tried in the context, and in the tasks and `asyncio.to_thread` threads that it starts."""
    found: set[Try] = set()
    token = _recorded.set(found)
    try:
        yield found
    finally:
        _recorded.reset(token)


def record(by: str, *ways: str) -> None:
    """Record that an attacker has tried entry points; call it beside the code that sends. Nothing in a sham campaign.

    Args:
        by: Attacker.
        ways: Entry points.
    """
    found = _recorded.get()
    if found is not None and not is_sham():
        found.update(Try(way, by) for way in ways)


def declared(tries: Mapping[str, Iterable[str]]) -> frozenset[Try]:
    """Return the attacks of a row from its entry points by attacker."""
    return frozenset(Try(way, by) for by, ways in tries.items() for way in ways)


def difference(wanted: frozenset[Try], tried: set[Try]) -> str:
    """Return the attacks that only one of declaration and record has; empty if there are none, or none is declared.

    Args:
        wanted: Declared attacks.
        tried: Recorded attacks.
    """
    if not wanted:
        return ""
    texts = [("Declared, but not tried", wanted - tried), ("Tried, but not declared", tried - wanted)]
    return " ".join(f"{text}: {', '.join(listed(tries))}." for text, tries in texts if tries)


def listed(tries: Iterable[Try]) -> list[str]:
    """Return attacks as texts for a report, sorted."""
    return sorted(f"{each.way} by {each.by}" for each in tries)


def way_of(key: str) -> str:
    """Return the entry point that a key of the bus belongs to.

    Args:
        key: Absolute or relative key.
    """
    parts = key.split("/")
    if parts[0] != "@" and "*" in key:
        return WILDCARDS
    relative = parts[_CELL_PARTS:] if parts[0] == "pcmrs" else parts
    return ROS_POSES if relative[:2] == ["ros2", "tracker"] else _FIRST[relative[0]]
