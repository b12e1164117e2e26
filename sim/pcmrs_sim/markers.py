"""The tracked marker bodies: reflecting spheres around a plate, as passive optical tools have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from pcmrs.spatial import Floats, Transform
from pcmrs_sim.shape import rotation_with_z

SPHERE_RADIUS = 0.0058
"""Radius of a sphere, m: common passive spheres have a diameter of 11.5 mm."""
PLATE_DISTANCE = 0.013
"""Distance from the centres of the spheres to the middle of the plate behind them, m: the posts."""
PLATE_RADIUS = 0.022
"""Radius of the plate, m. The arms from there to the spheres are too thin to hide anything."""


@dataclass(frozen=True, eq=False)
class MarkerBody:
    """Spheres in one plane, which are seen from the side of the plane's normal only.

    Attributes:
        positions: Centres of the spheres, in the frame of the marker body, m, (K, 3). Their mean is its origin, so that
            the noise of the spheres displaces the origin as little as possible.
        plane: Pose of the plane in that frame; its +z is the normal.
    """

    positions: Floats
    plane: Transform


def _planar(in_plane_mm: Sequence[tuple[float, float]], normal: tuple[float, float, float]) -> MarkerBody:
    """Return spheres in a plane through the origin.

    Args:
        in_plane_mm: Centres in the plane, mm.
        normal: Normal of the plane, of any length.
    """
    plane = Transform(rotation_with_z(normal), np.zeros(3))
    flat = np.array([(x, y, 0.0) for x, y in in_plane_mm]) * 1e-3
    return MarkerBody(plane @ flat, plane)


# No two distances within a body, and no two bodies, are alike: a tracker tells tools apart by them.
MARKER_BODIES = {
    # So inclined that the tracker sees it at all planned sites, also if the coil is turned by 0.6 rad.
    "coil": _planar(((-48, -22), (44, -30), (30, 34), (-26, 18)), (0.2, 0.3, 0.93)),
    "body_ref": _planar(((-40, -30), (46, -18), (16, 42), (-22, 6)), (0.0, 0.0, 1.0)),
    # Between the shaft and its side: seen both from the side and from above the person's hand.
    "pointer": _planar(((-35, -30), (35, -34), (22, 40), (-22, 24)), (sqrt(0.5), 0.0, sqrt(0.5))),
    "witness": _planar(((-44, 12), (28, -40), (36, 22), (-20, 6)), (0.0, 0.0, 1.0)),
}
"""Name of each tracked body to its spheres."""
