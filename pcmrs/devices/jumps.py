"""Whether a body can have gone from where it was to where it seems to be now."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pcmrs.spatial import Floats, Transform, distance, rotation_angle

SAME_PLACE = 0.02
"""A body that jumps to within so much of another one has been taken for it, m."""


@dataclass(frozen=True)
class PoseLimits:
    """Beyond these a pose is not believed; by default nothing is beyond them.

    Attributes:
        error: Largest fit error, m.
        speed: Greatest speed between two frames, m/s.
        turn: Greatest rate of rotation between two frames, rad/s.
        steady: A body that has jumped is believed again after so many frames without a jump.
    """

    error: float = math.inf
    speed: float = math.inf
    turn: float = math.inf
    steady: int = 10


class JumpGuard:
    """Finds jumps of tracked bodies: a phantom marker, a mistaken or a swapped tool.

    Args:
        limits: How fast a body can move, and how long it must be seen without a jump after one.
    """

    def __init__(self, limits: PoseLimits) -> None:
        self._limits = limits
        self._seen: dict[str, tuple[float, Transform]] = {}
        self._believed: dict[str, Floats] = {}
        self._steady: dict[str, int] = {}
        self._taken: set[str] = set()

    def doubt(self, body: str, exposed: float, tracker_from_body: Transform) -> str:
        """Why this pose of the body is not believed; empty when it is.

        Args:
            body: Name of the body.
            exposed: When it was seen so, s of the tracker's clock.
            tracker_from_body: Its measured pose.

        Returns:
            ``jump`` or ``swapped``; ``stamp_not_advancing`` for a frame that shows nothing new.
        """
        before = self._seen.get(body)
        if before is not None and exposed <= before[0]:
            return "stamp_not_advancing"
        self._seen[body] = exposed, tracker_from_body
        if self._leapt(body, before, tracker_from_body, exposed):
            self._steady[body] = -1
        if body in self._steady:
            self._steady[body] += 1
            if self._is_taken(body, before, tracker_from_body):
                self._steady[body] = 0
                return "swapped"
            if self._steady[body] < self._limits.steady:
                return "jump"
            del self._steady[body]
        self._believed[body] = tracker_from_body.translation
        return ""

    def forget_all(self) -> None:
        """Forgets all bodies, as when the tracker was restarted: also those that were never believed."""
        for known in (self._seen, self._believed, self._steady, self._taken):
            known.clear()

    def forget(self, body: str) -> None:
        """Forgets a body."""
        for known in (self._seen, self._believed, self._steady):
            known.pop(body, None)
        self._taken.discard(body)

    def _is_taken(self, body: str, before: tuple[float, Transform] | None, now: Transform) -> bool:
        """Whether a doubted body is where another one was, or has not left that one since, which may have moved."""
        if self._at_place_of_another(body, now):
            self._taken.add(body)
        elif before is None or distance(before[1], now) > SAME_PLACE:
            self._taken.discard(body)
        return body in self._taken

    def _leapt(self, body: str, before: tuple[float, Transform] | None, now: Transform, exposed: float) -> bool:
        """Whether it cannot have gone so far, or has come to the place of another one in a single step.

        After frames that are missing, and before its first one, a body may have gone far, but not to where another one
        was.
        """
        if before is not None and self._jumped(before[1], now, exposed - before[0]):
            return True
        is_guarded = self._limits.speed < math.inf
        is_far = before is None or distance(before[1], now) > SAME_PLACE
        return is_guarded and is_far and self._at_place_of_another(body, now)

    def _jumped(self, before: Transform, now: Transform, time: float) -> bool:
        if distance(before, now) > self._limits.speed * time:
            return True
        return self._limits.turn < math.inf and rotation_angle(before, now) > self._limits.turn * time

    def _at_place_of_another(self, body: str, tracker_from_body: Transform) -> bool:
        others = (place for other, place in self._believed.items() if other != body)
        return any(float(np.linalg.norm(tracker_from_body.translation - place)) < SAME_PLACE for place in others)
