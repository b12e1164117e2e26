"""What one PoseStamped of ROS says of a tracked body.

From the stamps of a sender's monotonic clock to the wall's time, which ROS stamps with.
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
    """The wall's time of what one sender measured.

    How long ago it was comes from the sender's own stamps; what the way from there took beyond the quickest message is
    taken off, so that two messages that arrive together do not seem to be of one moment.

    Args:
        clock: Of the cell.
        rate: Seconds of that clock per second of the machine.
    """

    def __init__(self, clock: Clock, rate: float) -> None:
        self._clock = clock
        self._rate = rate
        self._lateness = Lateness()

    def of(self, captured: float, sent: float) -> float:
        """Unix seconds of a measurement.

        Args:
            captured: When it was made, s of the sender's clock.
            sent: When it was sent; a sender without sense counts as one that measures and sends at once.
        """
        late = self._lateness.update(sent, self._clock.monotonic())
        age = sent - captured
        known = age if 0.0 <= age < _LONGEST else 0.0
        return self._clock.wall() - (known + late) / self._rate


def stamp_of(message: PoseStamped) -> float:
    """Unix seconds of the measurement."""
    stamp = message.header.stamp
    return stamp.sec + stamp.nanosec * 1e-9


def tracker_from_body(message: PoseStamped, frame: str, wall: float, max_age: float) -> Transform:
    """The pose, of the frame and age that are asked for.

    Args:
        message: As it came.
        frame: Which ``frame_id`` it has to have.
        wall: Unix seconds now.
        max_age: Seconds.

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
        text = f"The pose was {age:.3f} s old when it came, the limit is {max_age:g} s: {_CLOCKS}"
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
