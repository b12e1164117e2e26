"""The last minute of how far the tool was from its plan, and the body from where it was. Pure."""

from __future__ import annotations

from collections import deque
from math import radians
from typing import NamedTuple

from pcmrs.console.cell_view_model import CellViewModel
from pcmrs.console.geometry import placement
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.workflows.data import as_transform

SHOWN = 60.0
"""So much of the past is kept, s."""


class Moment(NamedTuple):
    """One moment; None for what was not known then.

    Attributes:
        at: s of `CellViewModel.now`.
        tool: Distance of the tool from its plan, m, and angle between both, rad.
        body: How far the body's reference has moved since it was seen first, m, and turned, rad.
    """

    at: float
    tool: tuple[float, float] | None
    body: tuple[float, float] | None


class Traces:
    """What was known at each look."""

    def __init__(self) -> None:
        self.moments: deque[Moment] = deque()
        self._begun: Transform | None = None

    def look(self, told: CellViewModel) -> None:
        """Add the present moment; where time has gone back, as in a replay, it begins anew."""
        coil, body_ref = told.poses.get("coil"), told.poses.get("body_ref")
        if self.moments and told.now < self.moments[-1].at:
            self.moments.clear()
            self._begun = None
        found = placement(told.data, coil, body_ref)
        tool = None if found is None else (found.mm[0] / 1000.0, radians(found.degrees))
        self.moments.append(Moment(told.now, tool, self._moved(body_ref)))
        while self.moments[0].at < told.now - SHOWN:
            self.moments.popleft()

    def begin_anew(self) -> None:
        """From now on the body is compared with where it is seen next."""
        self._begun = None

    def _moved(self, body_ref: BodyPose | None) -> tuple[float, float] | None:
        if body_ref is None or not body_ref.valid:
            return None
        seen = as_transform(body_ref)
        self._begun = seen if self._begun is None else self._begun
        return distance(self._begun, seen), rotation_angle(self._begun, seen)
