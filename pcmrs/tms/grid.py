"""Grids of coil poses on the scalp, in the order in which they are mapped."""

from __future__ import annotations

import math

import numpy as np

from pcmrs.errors import GeometryError
from pcmrs.spatial import Floats, Transform
from pcmrs.tms.scalp import NearestPoints, along_scalp

__all__ = ["grid_on_scalp", "rows_on_scalp"]

CORNERS = np.array([(math.cos(k * math.pi / 3.0), math.sin(k * math.pi / 3.0)) for k in range(6)])
MAX_RINGS = 20
MAX_ROWS = 20


def grid_on_scalp(closest: NearestPoints, centre: Transform, spacing: float, rings: int) -> tuple[Transform, ...]:
    """Return poses of a hexagonal grid in a spiral from its centre outwards.

    Each pose is next to the previous one.

    Every pose is tangent to the scalp. Its handle is that of the centre, carried along without a turn.

    Args:
        closest: Query for the nearest points of the scalp.
        centre: ``image_from_coil`` of the middle. It is moved onto the scalp.
        spacing: Distance between neighbours along the scalp, m.
        rings: Number of rings around the centre: 0 for the centre alone, 1 for 7 poses, 2 for 19.

    Raises:
        GeometryError: The spacing is not positive, there are not 0 to `MAX_RINGS` rings, or the centre's +z axis points
            into the head.
    """
    if not (math.isfinite(spacing) and spacing > 0.0) or not 0 <= rings <= MAX_RINGS:
        text = f"A grid has a positive spacing and 0 to {MAX_RINGS} rings, not {spacing:g} m and {rings}."
        raise GeometryError(text, spacing=spacing, rings=rings)
    return along_scalp(closest, centre, hexagons(rings) * spacing)


def rows_on_scalp(
    closest: NearestPoints, centre: Transform, spacing: float, rows: int, columns: int
) -> tuple[Transform, ...]:
    """Return poses of a rectangular grid row by row in alternating directions.

    Each pose is next to the previous one.

    Rows lie along x of the centre, and the first row is on the +y side. Every pose is tangent to the scalp. Its handle
    is that of the centre, carried along without a turn.

    Args:
        closest: Query for the nearest points of the scalp.
        centre: ``image_from_coil`` of the middle. It is moved onto the scalp.
        spacing: Distance between neighbours along the scalp, m.
        rows: Number of rows, 1 to `MAX_ROWS`.
        columns: Number of poses per row, 1 to `MAX_ROWS`.

    Raises:
        GeometryError: The spacing is not positive, there are not 1 to `MAX_ROWS` rows or columns, or the centre's +z
            axis points into the head.
    """
    if not (math.isfinite(spacing) and spacing > 0.0) or not (1 <= rows <= MAX_ROWS and 1 <= columns <= MAX_ROWS):
        given = f"{spacing:g} m, {rows} and {columns}"
        text = f"A grid has a positive spacing and 1 to {MAX_ROWS} rows and columns, not {given}."
        raise GeometryError(text, spacing=spacing, rows=rows, columns=columns)
    x, y = np.arange(columns) - (columns - 1) / 2.0, (rows - 1) / 2.0 - np.arange(rows)
    places = [(each, row) for number, row in enumerate(y) for each in (x if number % 2 == 0 else x[::-1])]
    return along_scalp(closest, centre, np.array(places) * spacing)


def hexagons(rings: int) -> Floats:
    """Return places of a hexagonal grid with unit spacing, in a spiral outwards, (1 + 3 rings (rings + 1), 2)."""
    places = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        steps = np.arange(ring)[None, :, None] / ring
        sides = CORNERS[:, None] + steps * (np.roll(CORNERS, -1, axis=0) - CORNERS)[:, None]
        # Each ring ends at its first corner, which is next to the start of the following ring.
        places.append(np.roll(ring * sides.reshape(-1, 2), -1, axis=0))
    return np.concatenate(places)
