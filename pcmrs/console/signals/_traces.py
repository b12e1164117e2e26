"""Deviations of the tool from its plan, and of the body from its first pose, in the last minute. Pure."""

from __future__ import annotations

from collections import deque
from math import radians
from typing import NamedTuple

from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._geometry import placement_deviation, tool_tip
from pcmrs.messages import BodyPose
from pcmrs.messages.setup import Setup
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.workflows.data import as_transform

SHOWN = 60.0
"""Duration of the stored past, s."""


class Moment(NamedTuple):
    """One moment; None for unknown values.

    Attributes:
        at: Time, s of `CellViewModel.now`.
        tool: Distance of the tool from its plan, m, and angle between both, rad.
        body: Distance, m, and turn, rad, of the body's reference since it was first seen.
    """

    at: float
    tool: tuple[float, float] | None
    body: tuple[float, float] | None


class Traces:
    """Deviations at each stored moment.

    Args:
        setup: Setup of the cell.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.moments: deque[Moment] = deque()
        self._reference: Transform | None = None

    def look(self, view: CellViewModel) -> None:
        """Add the present moment; restart if time has gone back, as in a replay."""
        measured, body_ref = tool_tip(self._setup, view.poses.get("coil")), view.poses.get("body_ref")
        if self.moments and view.now < self.moments[-1].at:
            self.moments.clear()
            self._reference = None
        found = placement_deviation(view.data, measured, body_ref)
        tool = None if found is None else (found.mm[0] / 1000.0, radians(found.degrees))
        self.moments.append(Moment(view.now, tool, self._moved(body_ref)))
        while self.moments[0].at < view.now - SHOWN:
            self.moments.popleft()

    def restart(self) -> None:
        """Compare the body with its next pose from now on."""
        self._reference = None

    def _moved(self, body_ref: BodyPose | None) -> tuple[float, float] | None:
        if body_ref is None or not body_ref.valid:
            return None
        seen = as_transform(body_ref)
        self._reference = seen if self._reference is None else self._reference
        return distance(self._reference, seen), rotation_angle(self._reference, seen)
