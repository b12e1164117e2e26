"""When the timers of a workflow begin, end and expire: the same for the dispatcher and for a simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec

from pcmrs.errors import ConfigurationError
from pcmrs.fsm.blueprint import Blueprint

__all__ = ["LEAST_S", "RunningTimer", "TimerChanges", "TimerSchedule", "duration"]

LEAST_S = 0.1
"""Least time of a timer, s: one that begins again and again must not fill the journal."""


def duration(blueprint: Blueprint, branch: str, timer: str, limits: Mapping[str, float]) -> float:
    """Return the time from the beginning of a timer to its event, s of the cell's clock.

    Args:
        blueprint: The workflow.
        branch: Branch of the timer.
        timer: Name of the timer.
        limits: The configuration's ``procedure.limits``; those that it lacks are the workflow's defaults.

    Raises:
        ConfigurationError: The limit is missing, or the time is not a number from `LEAST_S` on.
    """
    given = blueprint.branches[branch].timers[timer].after_s
    seconds: Any = given
    where = f"`after_s` of the timer {branch}.{timer}"
    if isinstance(given, str):
        seconds = limits[given] if given in limits else _default_limits(blueprint).get(given)
        where = f"The limit {given} of the timer {branch}.{timer}, procedure.limits.{given},"
        if seconds is None:
            text = f"{where} is missing: give it in [defaults.procedure.limits] of the workflow."
            raise ConfigurationError(text, limit=given)
    number = not isinstance(seconds, bool) and isinstance(seconds, int | float)
    if not number or not LEAST_S <= seconds < math.inf:
        text = f"{where} is {seconds!r}; it must be a number of seconds from {LEAST_S:g} on."
        raise ConfigurationError(text, value=str(seconds), least=LEAST_S)
    return float(seconds)


def _default_limits(blueprint: Blueprint) -> dict[str, Any]:
    procedure = blueprint.defaults.get("procedure")
    limits = procedure.get("limits") if isinstance(procedure, dict) else None
    return limits if isinstance(limits, dict) else {}


class RunningTimer(msgspec.Struct, frozen=True, kw_only=True):
    """A timer that has begun.

    Attributes:
        branch: Its branch.
        name: Its name.
        state: The state that it runs in.
        posts: The event operation that it posts.
        after: Time from its beginning to its event, s.
        due: Time of its event, s of a monotonic clock.
        expired: Its event was posted; it was not restarted since.
    """

    branch: str
    name: str
    state: str
    posts: str
    after: float
    due: float
    expired: bool = False

    @property
    def key(self) -> str:
        """Its name in the workflow, ``branch.timer``."""
        return f"{self.branch}.{self.name}"


class TimerChanges(msgspec.Struct, frozen=True, kw_only=True):
    """Timers that a command has ended, and those that it has begun, for the first time or again."""

    ended: list[RunningTimer] = []
    begun: list[RunningTimer] = []


class TimerSchedule:
    """Timers of a workflow that run now, each with the time of its event.

    A timer begins when its branch enters one of its states, and ends when the branch leaves that state. An operation
    that keeps the state changes nothing, unless it restarts the timer.

    Args:
        blueprint: The workflow.
        limits: The configuration's ``procedure.limits``.

    Attributes:
        running: ``branch.timer`` to the timer that runs.

    Raises:
        ConfigurationError: A limit that a timer names cannot be its time.
    """

    def __init__(self, blueprint: Blueprint, limits: Mapping[str, float]) -> None:
        self.running: dict[str, RunningTimer] = {}
        self._branches = {name: branch for name, branch in blueprint.branches.items() if branch.timers}
        self._after = {
            (name, key): duration(blueprint, name, key, limits)
            for name, branch in self._branches.items()
            for key in branch.timers
        }

    def follow(self, joint: Mapping[str, str], now: float, accepted: str = "") -> TimerChanges:
        """End and begin timers after a command.

        Args:
            joint: Joint state after the command: branch to state.
            now: Present time, s of a monotonic clock.
            accepted: The command, ``branch.operation``; empty if it was not accepted.
        """
        changes = TimerChanges(ended=[], begun=[])
        for name, branch in self._branches.items():
            state = joint[name]
            for key, timer in branch.timers.items():
                current = self.running.get(f"{name}.{key}")
                if current is not None and current.state != state:
                    changes.ended.append(self.running.pop(current.key))
                    current = None
                if state in timer.states and (current is None or accepted in timer.begins_again(name)):
                    after = self._after[name, key]
                    begun = RunningTimer(
                        branch=name, name=key, state=state, posts=timer.posts, after=after, due=now + after
                    )
                    self.running[begun.key] = begun
                    changes.begun.append(begun)
        return changes

    @property
    def next_due(self) -> float | None:
        """Time of the next event, s of the same clock; None if none is to come."""
        return min((each.due for each in self.running.values() if not each.expired), default=None)

    def expire(self, now: float) -> list[RunningTimer]:
        """Return the timers whose events are due, the earliest first; each is returned once."""
        due = [each for each in self.running.values() if not each.expired and each.due <= now]
        for each in due:
            self.running[each.key] = msgspec.structs.replace(each, expired=True)
        return sorted(due, key=lambda each: each.due)
