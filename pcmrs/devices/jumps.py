"""Detection of jumps: poses of a tracked body that it cannot have reached from its last one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pcmrs.spatial import Floats, Transform, distance, rotation_angle

SAME_PLACE = 0.02
"""A body that jumps to within this distance of another one has been swapped with it, m."""


@dataclass(frozen=True)
class PoseLimits:
    """Limits beyond which a pose is rejected; by default there are none.

    Attributes:
        error: Largest fit error, m.
        speed: Greatest speed between two frames, m/s.
        turn: Greatest rate of rotation between two frames, rad/s.
        steady: Number of frames without a jump after which a body that has jumped is accepted again.
    """

    error: float = math.inf
    speed: float = math.inf
    turn: float = math.inf
    steady: int = 10


class JumpGuard:
    """Detector of jumps of tracked bodies, as by a phantom marker or by swapped tools.

    Args:
        limits: Greatest speeds of a body, and number of frames without a jump after one.
    """

    def __init__(self, limits: PoseLimits) -> None:
        self._limits = limits
        self._last_seen: dict[str, tuple[float, Transform]] = {}
        self._accepted: dict[str, Floats] = {}
        self._steady: dict[str, int] = {}
        self._swapped: set[str] = set()

    def rejection_reason(self, body: str, exposed: float, tracker_from_body: Transform) -> str:
        """Return why a pose is rejected.

        Args:
            body: Name of the body.
            exposed: Time of the exposure, s of the tracker's clock.
            tracker_from_body: Measured pose of the body.

        Returns:
            ``jump`` or ``swapped``; ``stamp_not_advancing`` for a frame that is not new; empty for an accepted pose.
        """
        before = self._last_seen.get(body)
        if before is not None and exposed <= before[0]:
            return "stamp_not_advancing"
        self._last_seen[body] = exposed, tracker_from_body
        if self._is_jump(body, before, tracker_from_body, exposed):
            self._steady[body] = -1
        if body in self._steady:
            self._steady[body] += 1
            if self._is_swapped(body, before, tracker_from_body):
                self._steady[body] = 0
                return "swapped"
            if self._steady[body] < self._limits.steady:
                return "jump"
            del self._steady[body]
        self._accepted[body] = tracker_from_body.translation
        return ""

    def forget_all(self) -> None:
        """Forget all bodies, also those that were never accepted, as when the tracker was restarted."""
        for known in (self._last_seen, self._accepted, self._steady, self._swapped):
            known.clear()

    def forget(self, body: str) -> None:
        """Forget a body."""
        for known in (self._last_seen, self._accepted, self._steady):
            known.pop(body, None)
        self._swapped.discard(body)

    def _is_swapped(self, body: str, before: tuple[float, Transform] | None, now: Transform) -> bool:
        """Return True if a body jumped to the place of another one and has not moved away by itself since.

        The other body may have moved meanwhile.
        """
        if self._at_place_of_another(body, now):
            self._swapped.add(body)
        elif before is None or distance(before[1], now) > SAME_PLACE:
            self._swapped.discard(body)
        return body in self._swapped

    def _is_jump(self, body: str, before: tuple[float, Transform] | None, now: Transform, exposed: float) -> bool:
        """Return True if a body moved too fast, or came to the place of another one in a single step.

        A body may move far while frames are missing, and before its first frame, but not to the place of another one.
        """
        if before is not None and self._moved_too_fast(before[1], now, exposed - before[0]):
            return True
        is_guarded = self._limits.speed < math.inf
        is_far = before is None or distance(before[1], now) > SAME_PLACE
        return is_guarded and is_far and self._at_place_of_another(body, now)

    def _moved_too_fast(self, before: Transform, now: Transform, time: float) -> bool:
        if distance(before, now) > self._limits.speed * time:
            return True
        return self._limits.turn < math.inf and rotation_angle(before, now) > self._limits.turn * time

    def _at_place_of_another(self, body: str, tracker_from_body: Transform) -> bool:
        others = (place for other, place in self._accepted.items() if other != body)
        return any(float(np.linalg.norm(tracker_from_body.translation - place)) < SAME_PLACE for place in others)
