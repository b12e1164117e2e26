"""The places of a search on the scalp, and poses between them: what is left of the scalp in the journalled data."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from pcmrs.messages import PoseMessage
from pcmrs.spatial import Floats, Transform
from pcmrs.tms.hotspot_settings import HotspotSettings
from pcmrs.tms.scalp import heading, turned

NEIGHBOURS = 12
"""Places that the scalp around a point is fitted to: a quadric has 6 coefficients."""


class Chart:
    """Places and headings that may be asked for, and the scalp between them.

    Args:
        settings: Of the search; which headings.
        places: ``image_from_coil`` of the places, tangent to the scalp; the first is the centre.
    """

    def __init__(self, settings: HotspotSettings, places: Sequence[PoseMessage]) -> None:
        self.settings = settings
        self.places = tuple(as_transform(place) for place in places)
        self.positions: Floats = np.array([place.translation for place in self.places])
        turns = settings.turns
        self.headings: Floats = np.radians(settings.heading_step_deg * np.arange(-turns, turns + 1))
        """Against the place's own pose, rad, in order."""

        self.poses = tuple(turned(place, float(angle)) for place in self.places for angle in self.headings)
        """Every place with every heading."""

    def located(self, pose: Transform) -> tuple[Floats, float]:
        """Position of a pose, m, (3,), and its heading against the place that is nearest, rad."""
        nearest = int(np.argmin(np.linalg.norm(self.positions - pose.translation, axis=1)))
        return pose.translation, heading(self.places[nearest], pose)

    def pose(self, position: Floats, angle: float) -> Transform:
        """The pose on the scalp at a position between the places, turned by `angle` (rad) from theirs.

        The scalp is the quadric through the nearest places: within 0.1 mm of a head for places 7 mm apart.
        """
        distances = np.linalg.norm(self.positions - position, axis=1)
        nearest = np.argsort(distances, kind="stable")[:NEIGHBOURS]
        place = self.places[nearest[0]]
        local = place.inverse() @ self.positions[nearest]
        x, y, _ = place.inverse() @ position
        coefficients, *_ = np.linalg.lstsq(_quadric(local[:, 0], local[:, 1]), local[:, 2])
        height = float(_quadric(np.array([x]), np.array([y]))[0] @ coefficients)
        _, ax, ay, axx, axy, ayy = coefficients
        normal = np.array((-(ax + 2.0 * axx * x + axy * y), -(ay + 2.0 * ayy * y + axy * x), 1.0))
        normal /= np.linalg.norm(normal)
        tilt = np.cross((0.0, 0.0, 1.0), normal)
        sine = float(np.linalg.norm(tilt))
        rotvec = tilt * (np.arcsin(min(sine, 1.0)) / sine) if sine > 0.0 else tilt
        return turned(place @ Transform.from_rotvec((x, y, height), rotvec), angle)


@lru_cache(maxsize=8)
def chart_of(settings: HotspotSettings, places: tuple[PoseMessage, ...]) -> Chart:
    """The chart of a search; it stays the same for all its pulses."""
    return Chart(settings, places)


def as_transform(pose: PoseMessage) -> Transform:
    """The pose to compute with. Raises `GeometryError` where it is none."""
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)


def as_message(pose: Transform) -> PoseMessage:
    """The pose as data."""
    x, y, z = pose.translation.tolist()
    w, i, j, k = pose.quat_wxyz.tolist()
    return PoseMessage(position=(x, y, z), quat_wxyz=(w, i, j, k))


def _quadric(x: Floats, y: Floats) -> Floats:
    """Terms of a quadric at points of the tangent plane, (K, 6)."""
    terms: Floats = np.column_stack((np.ones_like(x), x, y, x * x, x * y, y * y))
    return terms
