"""Tracker between the simulated one and its node, which restarts its frame numbers or stamps a frame wrongly."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from typing import Any

import msgspec

from pcmrs.messages import BodyPose

AHEAD = 3600.0
"""Error of the stamp of a frame that is stamped ahead, s."""


class TamperedTracker:
    """Tracker that passes on everything unchanged unless it was ordered to change it.

    Args:
        tracker: Tracker that its driver has opened.
    """

    def __init__(self, tracker: Any) -> None:
        self._tracker = tracker
        self._first = 0
        self._restarts = self._stamps_ahead = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tracker, name)

    def restart(self) -> None:
        """Restart the frame numbers with the next frame."""
        self._restarts = True

    def stamp_ahead(self) -> None:
        """Stamp the next frame an hour ahead."""
        self._stamps_ahead = True

    async def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        """Yield frames of the tracker; see `pcmrs.devices.protocols.TrackerDriver`."""
        async for frame in self._tracker.frames():
            changed = [self._changed(pose) for pose in self._restarted_at(frame)]
            self._stamps_ahead = self._stamps_ahead and not changed
            yield changed

    def _restarted_at(self, frame: Sequence[BodyPose]) -> Sequence[BodyPose]:
        if self._restarts and frame:
            self._first, self._restarts = min(pose.frame_number for pose in frame), False
        return frame

    def _changed(self, pose: BodyPose) -> BodyPose:
        if not (self._first or self._stamps_ahead):
            return pose
        ahead = AHEAD if self._stamps_ahead else 0.0
        return msgspec.structs.replace(
            pose,
            frame_number=pose.frame_number - self._first,
            captured=pose.captured + ahead,
            sent=pose.sent + ahead,
        )
