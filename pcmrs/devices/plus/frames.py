"""Tracker frames out of single transforms: those of one stamp belong together."""

from __future__ import annotations

import math
from collections.abc import Mapping

from pcmrs.devices.plus.readings import Reading
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform

AGREEMENT = 0.5
"""Clocks agree when the first stamp of a connection is no younger than now and no older than this, s."""


class Frames:
    """Collects the readings of one stamp; a stamp that does not advance is the same frame.

    Stamps are Unix seconds of the server. Where its clock agrees with ours, a frame was captured at its stamp, however
    late it comes; otherwise `latency` before it arrived.

    Args:
        bodies: Name of a transform to the body it is of.
        latency: From exposure to arrival where the clocks do not agree, s.
    """

    def __init__(self, bodies: Mapping[str, str], latency: float) -> None:
        self._bodies = bodies
        self._latency = latency
        self._number = 0
        self.restart()

    @property
    def waiting(self) -> bool:
        """Whether a frame has begun that lacks bodies."""
        return bool(self._found)

    def restart(self) -> None:
        """Another connection: stamps may begin anew, frame numbers go on."""
        self._found: dict[str, Reading] = {}
        self._stamp = -math.inf
        self._arrived = 0.0
        self._monotonic_from_unix: float | None = None

    def take(
        self, found: Mapping[str, Reading], stamp: float, now: float, wall: float, *, whole: bool = False
    ) -> list[list[BodyPose]]:
        """The frames that are complete now.

        Args:
            found: Transform name to reading; names of no body are left out.
            stamp: Of the message, Unix seconds.
            now: Of the monotonic clock, s.
            wall: Unix seconds.
            whole: Nothing else will come with this stamp.
        """
        known = {self._bodies[name]: reading for name, reading in found.items() if name in self._bodies}
        ready = [self.finish(now)] if self._found and stamp > self._stamp else []
        if not known or stamp < self._stamp or (stamp == self._stamp and not self._found):
            return ready  # older than what is out already, or that very frame again
        if stamp > self._stamp:
            self._begin(stamp, now, wall)
        self._found |= known
        if whole or len(self._found) == len(self._bodies):
            ready.append(self.finish(now))
        return ready

    def finish(self, now: float) -> list[BodyPose]:
        """The frame that has begun; a body that did not come with it is not seen."""
        self._number += 1
        found, self._found = self._found, {}
        return [self._pose(body, found.get(body, "not_sent"), now) for body in self._bodies.values()]

    def _begin(self, stamp: float, now: float, wall: float) -> None:
        if self._stamp == -math.inf and 0.0 <= wall - stamp <= AGREEMENT:
            self._monotonic_from_unix = now - wall
        self._stamp, self._arrived = stamp, now

    def _pose(self, body: str, reading: Reading, now: float) -> BodyPose:
        offset = self._monotonic_from_unix
        captured = self._arrived - self._latency if offset is None else self._stamp + offset
        if not isinstance(reading, Transform):
            return BodyPose(
                body=body, frame_number=self._number, captured=captured, sent=now, valid=False, reason=reading
            )
        x, y, z = reading.translation.tolist()
        w, i, j, k = reading.quat_wxyz.tolist()
        return BodyPose(
            body=body,
            frame_number=self._number,
            captured=captured,
            sent=now,
            valid=True,
            position=(x, y, z),
            quat_wxyz=(w, i, j, k),
        )
