"""Sessions of a tracker: within one session, frame numbers and time stamps advance."""

from __future__ import annotations

import secrets
from collections.abc import Sequence

import msgspec

from pcmrs.messages import BodyPose

FRAMES_TO_RESTART = 5
"""Number of successive frames that advance from below the last one after which the tracker has restarted its count.

A single such frame is an error, and the frames of a tracker that runs backwards do not advance.
"""


class FrameSessions:
    """Publisher that adds the session id to the frames that the node of a tracker publishes.

    Only here do the frames of a driver arrive in order, so only here can a tracker that restarts its count be
    distinguished from a frame that was delayed on the network. A new session begins when the node starts and when the
    tracker restarts its count. One frame with a stamp that is ahead begins no session: receivers would forget earlier
    poses, and with them which bodies the tracker has swapped.
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
            self._last = number, sent  # only the stamp of the last frame was ahead: go on from the one before it
            return
        before, self._behind = self._behind, (number, sent)
        advances = before is not None and number > before[0] and sent > before[1]
        self._advanced = self._advanced + 1 if advances else 1
        if self._advanced == FRAMES_TO_RESTART:
            self._begin()
            self._last = number, sent
