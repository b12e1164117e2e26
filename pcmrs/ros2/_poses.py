"""Poses of tracked bodies in PoseStamped messages of ROS, and their stamps.

Senders stamp with a monotonic clock, ROS with wall time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pcmrs.clock import Clock
from pcmrs.devices.lateness import Lateness
from pcmrs.devices.plus.frames import APART
from pcmrs.errors import GeometryError, RefusalError
from pcmrs.ros2.cdr import PoseStamped
from pcmrs.spatial import Transform

_LONGEST = 60.0


class Stamps:
    """Wall times of the measurements of one sender.

    The age of a measurement comes from the sender's own stamps. The delay of a message beyond the quickest one is
    subtracted, so that two messages that arrive together do not seem to be simultaneous.

    Args:
        clock: Clock of the cell.
        rate: Seconds of that clock per second of the machine.
    """

    def __init__(self, clock: Clock, rate: float) -> None:
        self._clock = clock
        self._rate = rate
        self._lateness = Lateness()

    def of(self, captured: float, sent: float) -> float:
        """Return the Unix time of a measurement, s.

        Args:
            captured: Time of the measurement, s of the sender's clock.
            sent: Time of sending, s of the sender's clock. With an impossible difference, the measurement counts as
                just sent.
        """
        late = self._lateness.update(sent, self._clock.monotonic())
        age = sent - captured
        known = age if 0.0 <= age < _LONGEST else 0.0
        return self._clock.wall() - (known + late) / self._rate


def stamp_of(message: PoseStamped) -> float:
    """Return the Unix time of the measurement, s."""
    stamp = message.header.stamp
    return stamp.sec + stamp.nanosec * 1e-9


def tracker_from_body(message: PoseStamped, frame: str, wall: float, max_age: float) -> Transform:
    """Return the pose, if it has the required frame and age.

    Args:
        message: The message as received.
        frame: Required ``frame_id``.
        wall: Wall time now, Unix s.
        max_age: Largest age, s.

    Raises:
        RefusalError: ``wrong_frame``, ``stamp_ahead``, ``stamp_old``, ``not_finite`` or ``not_unit``.
    """
    if message.header.frame_id != frame:
        text = f"The pose is in {message.header.frame_id!r}, not in {frame!r}: set ros2.frame, or transform it in ROS."
        raise RefusalError("wrong_frame", text, frame=message.header.frame_id, wanted=frame)
    age = wall - stamp_of(message)
    if age < -APART:
        text = f"The pose is stamped {-age:.3f} s ahead of this machine's clock, the limit is {APART:g} s: {_CLOCKS}"
        raise RefusalError("stamp_ahead", text, age=age, limit=-APART)
    if age > max_age:
        text = f"The pose was {age:.3f} s old when it arrived, the limit is {max_age:g} s: {_CLOCKS}"
        raise RefusalError("stamp_old", text, age=age, limit=max_age)
    at, turn = message.pose.position, message.pose.orientation
    position, quat_xyzw = (at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w)
    _require_finite(position, quat_xyzw)
    try:
        return Transform.from_quat_xyzw(position, quat_xyzw)
    except GeometryError as error:
        raise RefusalError("not_unit", error.text, **error.fields) from None


_CLOCKS = "synchronise the clocks of both machines, and stamp at the exposure."


def _require_finite(position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
    if not all(map(math.isfinite, (*position, *quat_xyzw))):
        raise RefusalError("not_finite", "The pose holds a number that is not finite; publish a body's pose when seen.")
