"""A tracker between the simulated one and its node: it counts anew, or stamps a frame wrongly."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from typing import Any

import msgspec

from pcmrs.messages import BodyPose

AHEAD = 3600.0
"""A frame that is stamped ahead is so by this, s."""


class TamperedTracker:
    """Passes on everything but what it was told to change.

    Args:
        tracker: As its driver has opened it.
    """

    def __init__(self, tracker: Any) -> None:
        self._tracker = tracker
        self._first = 0
        self._restarts = self._stamps_ahead = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tracker, name)

    def restart(self) -> None:
        """It counts its frames anew from the next one on."""
        self._restarts = True

    def stamp_ahead(self) -> None:
        """Its next frame is stamped an hour ahead."""
        self._stamps_ahead = True

    async def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        """Frames of the tracker; see `pcmrs.devices.protocols.TrackerDriver`."""
        async for frame in self._tracker.frames():
            yield [self._changed(pose) for pose in self._begun(frame)]
            self._stamps_ahead = False

    def _begun(self, frame: Sequence[BodyPose]) -> Sequence[BodyPose]:
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
