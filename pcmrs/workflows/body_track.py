"""Where the body is now, by frames of the tracker that come late."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.spatial import Transform
from pcmrs.spatial.prediction import PosePredictor
from pcmrs.workflows.alignment import TrackerFrame
from pcmrs.workflows.settings import FollowingSettings

MIN_SPEED = 1e-6
"""No limit for what is slower, m/s."""
CLOCK_FRAMES = 256
"""Frames by which the clocks of tracker and cell are compared: over four seconds two clocks drift by less than 1 ms."""


class BodyTrack:
    """Predicts the pose of the body's reference in the tracker frame; beyond a gap it refuses.

    Args:
        settings: Of following.
    """

    def __init__(self, settings: FollowingSettings) -> None:
        self._settings = settings
        self._predictor = PosePredictor()
        self._delays: deque[float] = deque(maxlen=CLOCK_FRAMES)
        self._newest: TrackerFrame | None = None

    def take(self, frame: TrackerFrame) -> float:
        """Takes a frame, and returns how much later than the one before it was exposed, s; 0 for the first.

        Raises:
            RefusalError: ``tracker_restarted``: the tracker counts anew since the frame before; otherwise see
                `PosePredictor.update`.
        """
        seen, before = frame["body_ref"], self._newest
        if before is not None and seen.session != before["body_ref"].session:
            text = "The tracker was restarted: where it stands and what its stamps mean may have changed. Back off, "
            raise RefusalError("tracker_restarted", text + "then begin again.")
        self._predictor.update(seen.exposed, seen.tracker_from_body)
        self._delays.append(seen.captured - seen.exposed)
        self._newest = frame
        return 0.0 if before is None else seen.exposed - before["body_ref"].exposed

    def stamp(self, time: float) -> float:
        """The time in the stamps of the tracker for which the pose is wanted where the arm is told at `time`, s.

        Raises:
            RefusalError: Tool and body have not been seen together lately.
        """
        settings, newest = self._settings, self._newest
        age = math.inf if newest is None else time - newest["body_ref"].captured
        if newest is None or age > settings.longest_gap:
            text = (
                f"Tool and body have not been seen together for {age:.3f} s, the limit is {settings.longest_gap:g} s: "
                "the tool does not follow what is not seen. Clear the line of sight, then back off."
            )
            raise RefusalError("pose_stale", text, age=age, limit=settings.longest_gap)
        if not settings.compensated:
            return newest["body_ref"].exposed
        # The quickest of many frames tells how the two clocks differ; others were on their way for longer.
        ahead = time - min(self._delays) + settings.lead - newest["body_ref"].exposed
        speed = float(np.linalg.norm(self._predictor.velocity))
        return newest["body_ref"].exposed + min(ahead, settings.farthest_lead / max(speed, MIN_SPEED))

    def pose(self, stamp: float) -> Transform:
        """``tracker_from_body_ref`` at a time of `stamp`. Raises `RefusalError`: see `PosePredictor.at`."""
        return self._predictor.at(stamp)
