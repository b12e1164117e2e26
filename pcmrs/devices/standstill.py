"""Detection of unrequested motion: displacement of an arm from the posture in which it came to rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from pcmrs.messages import DeviceEvent, JointState

MOVED = "moved_unasked"
"""Code of the danger event."""

THRESHOLD = 0.02
"""Displacement of a joint that is a danger, rad: more than sensors, gears and a hand on the tool explain."""

RELIEF_THRESHOLD = 0.1
"""Threshold while the arm relieves a force after a force stop, rad; its driver bounds that motion by `relief_mm`."""

LONGEST_GAP = 1.0
"""Gap in the joint states after which the reference posture is taken again, s of the robot."""


class Standstill:
    """Watch over measured joints while nothing moves the arm; pure.

    Each standstill and each report set a new reference posture, so that one displacement is reported once.
    """

    def __init__(self) -> None:
        self._posture: Sequence[float] | None = None
        self._seen = 0.0
        self._movers = 0
        self._streamed = False
        self._limit = THRESHOLD
        self._watched = False

    def watch(self, watched: bool) -> None:
        """Start or end the watch; an arm is watched while it is connected."""
        if watched != self._watched:
            self._watched = watched
            self.forget()

    def forget(self) -> None:
        """Take the next measured joints as the reference posture, because the arm has come to rest."""
        self._posture, self._limit = None, THRESHOLD

    @contextmanager
    def moving(self, *, streamed: bool = False) -> Iterator[None]:
        """Suspend the watch for the length of the context, in which something moves or brakes the arm.

        Args:
            streamed: True if set points move the arm after that, until something else moves or brakes it.
        """
        self._movers += 1
        self._streamed = streamed
        try:
            yield
        finally:
            self._movers -= 1
            self.forget()

    def take(self, state: JointState) -> DeviceEvent | None:
        """Take measured joints, and return the danger event if the arm was displaced."""
        gap, self._seen = state.captured - self._seen, state.captured
        if not self._watched or self._movers or self._streamed:
            return None
        if state.relieving:
            self._limit = RELIEF_THRESHOLD
        elif self._limit == RELIEF_THRESHOLD and not state.moving:
            self.forget()
        if self._posture is None or gap > LONGEST_GAP:
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
