"""Sessions of a tracker: within one, frame numbers and stamps advance."""

from __future__ import annotations

import secrets
from collections.abc import Sequence

import msgspec

from pcmrs.messages import BodyPose

STEADY = 5
"""So many frames in a row that advance from below the last one show that the tracker counts anew. One is a mistake, and
a tracker that runs backwards never does so."""


class FrameSessions:
    """Names the session of each frame as the node of a tracker publishes it.

    The frames of a driver come in order here, so that only here a tracker that counts anew can be told from a frame
    that was late on the network. A new session begins with the node, and where the tracker behind it counts anew. One
    frame with a stamp ahead begins none: where bodies were seen before would be forgotten, and which of them the
    tracker has mistaken for each other.
    """

    def __init__(self) -> None:
        self._begin()

    def named(self, frame: Sequence[BodyPose]) -> list[BodyPose]:
        """Return the poses of one frame with the id of their session."""
        if frame:
            self._follow(max(pose.frame_number for pose in frame), max(pose.sent for pose in frame))
        return [msgspec.structs.replace(pose, session=self._session) for pose in frame]

    def _begin(self) -> None:
        self._session = secrets.token_hex(8)
        self._last: tuple[int, float] | None = None
        self._before: tuple[int, float] | None = None
        self._behind: tuple[int, float] | None = None
        self._advanced = 0

    def _follow(self, number: int, sent: float) -> None:
        if self._last is None or (number >= self._last[0] and sent >= self._last[1]):
            self._before, self._last, self._behind, self._advanced = self._last, (number, sent), None, 0
            return
        if self._before is not None and number >= self._last[0] and sent >= self._before[1]:
            self._last = number, sent  # it goes on from the frame before the last one, whose stamp alone was ahead
            return
        before, self._behind = self._behind, (number, sent)
        advances = before is not None and number > before[0] and sent > before[1]
        self._advanced = self._advanced + 1 if advances else 1
        if self._advanced == STEADY:
            self._begin()
            self._last = number, sent
