"""A grid of coil poses on the scalp, in the order in which they are mapped."""

from __future__ import annotations

import math

import numpy as np

from pcmrs.errors import GeometryError
from pcmrs.spatial import Floats, Transform
from pcmrs.tms.scalp import Closest, along_scalp

CORNERS = np.array([(math.cos(k * math.pi / 3.0), math.sin(k * math.pi / 3.0)) for k in range(6)])
MAX_RINGS = 20


def grid_on_scalp(closest: Closest, centre: Transform, spacing: float, rings: int) -> tuple[Transform, ...]:
    """Poses of a hexagonal grid, in a spiral from its centre outwards: each is next to the one before.

    Every pose is tangent to the scalp, its handle as that of the centre carried along without a turn.

    Args:
        closest: The scalp.
        centre: ``image_from_coil`` of the middle; it is brought onto the scalp.
        spacing: Between neighbours, along the scalp, m.
        rings: Around the centre: 0 for it alone, 1 for 7 poses, 2 for 19.

    Raises:
        GeometryError: The spacing is not positive, there are not 0 to `MAX_RINGS` rings, or the centre's +z points
            into the head.
    """
    if not (math.isfinite(spacing) and spacing > 0.0) or not 0 <= rings <= MAX_RINGS:
        text = f"A grid has a positive spacing and 0 to {MAX_RINGS} rings, not {spacing:g} m and {rings}."
        raise GeometryError(text, spacing=spacing, rings=rings)
    return along_scalp(closest, centre, hexagons(rings) * spacing)


def hexagons(rings: int) -> Floats:
    """Places of a hexagonal grid with unit spacing, in a spiral outwards, (1 + 3 rings (rings + 1), 2)."""
    places = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        steps = np.arange(ring)[None, :, None] / ring
        sides = CORNERS[:, None] + steps * (np.roll(CORNERS, -1, axis=0) - CORNERS)[:, None]
        # Each ring ends at its first corner, next to which the ring around it begins.
        places.append(np.roll(ring * sides.reshape(-1, 2), -1, axis=0))
    return np.concatenate(places)
