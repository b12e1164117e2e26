"""Whether an arm moves although nothing moves it: its displacement from the posture in which it came to rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from pcmrs.messages import DeviceEvent, JointState

MOVED = "moved_unasked"
"""Code of the danger event."""

THRESHOLD = 0.02
"""Displacement of a joint that is a danger, rad: beyond what sensors, gears and a hand on the tool explain."""

GIVING_WAY = 0.1
"""The same while the arm relieves a force after a force stop, rad; its driver bounds that by `relief_mm`."""

GAP = 1.0
"""Without a joint state for so long the posture is taken anew, s of the robot: nobody has watched it meanwhile."""


class Standstill:
    """Watches measured joints while nothing moves the arm; pure.

    Every standstill sets the posture anew, so that one displacement is reported once.
    """

    def __init__(self) -> None:
        self._posture: Sequence[float] | None = None
        self._seen = 0.0
        self._movers = 0
        self._streamed = False
        self._limit = THRESHOLD
        self._watched = False

    def watch(self, watched: bool) -> None:
        """Watches, or does not: only where the arm is connected and nothing moves it."""
        if watched != self._watched:
            self._watched = watched
            self.forget()

    def forget(self) -> None:
        """The arm has come to rest: the next joints are the posture in which it shall stay."""
        self._posture, self._limit = None, THRESHOLD

    @contextmanager
    def moving(self, *, streamed: bool = False) -> Iterator[None]:
        """Something moves the arm, or brakes it, for as long as the context lasts.

        Args:
            streamed: Set points go on moving it after that, until something else moves or brakes it.
        """
        self._movers += 1
        self._streamed = streamed
        try:
            yield
        finally:
            self._movers -= 1
            self.forget()

    def take(self, state: JointState) -> DeviceEvent | None:
        """Takes measured joints: the danger event if the arm was displaced."""
        gap, self._seen = state.captured - self._seen, state.captured
        if not self._watched or self._movers or self._streamed:
            return None
        if state.relieving:
            self._limit = GIVING_WAY
        elif self._limit == GIVING_WAY and not state.moving:
            self.forget()
        if self._posture is None or gap > GAP:
            self._posture = state.positions
            return None
        turned = [abs(now - then) for now, then in zip(state.positions, self._posture, strict=True)]
        displacement = max(turned, default=0.0)
        if displacement <= self._limit:
            return None
        event = _moved(turned.index(displacement), displacement, self._limit)
        self.forget()
        return event


def _moved(joint: int, displacement: float, limit: float) -> DeviceEvent:
    text = f"Joint {joint + 1} was displaced by {displacement:.3f} rad while nothing moved the robot, limit "
    text += f"{limit:g} rad. It was held: look at the arm, then acknowledge."
    fields = {"joint": joint + 1, "displacement": displacement, "limit": limit}
    return DeviceEvent(device="robot", code=MOVED, text=text, danger=True, fields=fields)
