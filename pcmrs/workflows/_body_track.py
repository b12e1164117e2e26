"""Present pose of the body from frames of the tracker that arrive late."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.spatial import Transform
from pcmrs.spatial.prediction import PosePredictor
from pcmrs.workflows._alignment import TrackerFrame
from pcmrs.workflows.settings import FollowingSettings

MIN_SPEED = 1e-6
"""Least speed by which the prediction is limited, m/s."""
CLOCK_FRAMES = 256
"""Number of frames by which the clocks of tracker and cell are compared: over four seconds, two clocks drift by less
than 1 ms."""


class BodyTrack:
    """Predictor of the pose of the body's reference in the tracker frame, which refuses after a gap.

    Args:
        settings: Settings of following.
    """

    def __init__(self, settings: FollowingSettings) -> None:
        self._settings = settings
        self._predictor = PosePredictor()
        self._delays: deque[float] = deque(maxlen=CLOCK_FRAMES)
        self._newest: TrackerFrame | None = None

    def take(self, frame: TrackerFrame) -> float:
        """Take a frame, and return the time of its exposure after that of the previous frame, s; 0 for the first frame.

        Raises:
            RefusalError: ``tracker_restarted``: the tracker has restarted its counts since the previous frame;
                otherwise see `PosePredictor.update`.
        """
        seen, before = frame["body_ref"], self._newest
        if before is not None and seen.session != before["body_ref"].session:
            text = (
                "The tracker was restarted: its place and the meaning of its stamps may have changed. Back off, then "
            )
            raise RefusalError("tracker_restarted", text + "restart.")
        self._predictor.update(seen.exposed, seen.tracker_from_body)
        self._delays.append(seen.captured - seen.exposed)
        self._newest = frame
        return 0.0 if before is None else seen.exposed - before["body_ref"].exposed

    def stamp(self, time: float) -> float:
        """Return the time on the tracker's clock for which the pose is needed, s.

        Args:
            time: Time at which the arm is commanded, s of the cell.

        Raises:
            RefusalError: Tool and body have not been seen together recently.
        """
        settings, newest = self._settings, self._newest
        age = math.inf if newest is None else time - newest["body_ref"].captured
        if newest is None or age > settings.longest_gap:
            text = (
                f"Tool and body have not been seen together for {age:.3f} s, the limit is {settings.longest_gap:g} s: "
                "the tool does not follow an unseen body. Clear the line of sight, then back off."
            )
            raise RefusalError("pose_stale", text, age=age, limit=settings.longest_gap)
        if not settings.compensated:
            return newest["body_ref"].exposed
        # The frame with the least delay shows the difference of the two clocks. All others were delayed for longer.
        ahead = time - min(self._delays) + settings.lead - newest["body_ref"].exposed
        speed = float(np.linalg.norm(self._predictor.velocity))
        return newest["body_ref"].exposed + min(ahead, settings.farthest_lead / max(speed, MIN_SPEED))

    def pose(self, stamp: float) -> Transform:
        """Return ``tracker_from_body_ref`` at a time from `stamp`. Raises `RefusalError` as `PosePredictor.at`."""
        return self._predictor.at(stamp)
