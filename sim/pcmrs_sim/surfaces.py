"""The true surfaces of the phantoms as triangle meshes, in the image frame (RAS, m).

They are computed from formulas. Of a patient, the surface would come from a segmented scan, and have its errors.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats
from pcmrs_sim import femur, head
from pcmrs_sim.femur import FEMUR
from pcmrs_sim.head import HEAD
from pcmrs_sim.phantom import Phantom

Field = Callable[[Floats], Floats]
"""Implicit function at points (..., 3), m: negative inside, zero on the surface, positive outside; (...,)."""
Ints = npt.NDArray[np.int64]
HEAD_CELL = 0.0048
"""Size of a grid cell for the head, m."""
FEMUR_CELL = 0.0024
"""Size of a grid cell for the femur, m."""
MARGIN = 2
"""Width of the margin around the body, in grid cells."""
DECIMALS = 6
"""Decimals of coordinates in m: rounding makes files equal on all machines."""
_GRADIENT_STEP = 1e-6  # m
_NEWTON_STEPS = 4
_CORNERS = np.array(list(np.ndindex(2, 2, 2)))
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]


def head_surface() -> tuple[Floats, Ints]:
    """Return vertices, m, (V, 3), and faces, (F, 3), of the scalp, counter-clockwise seen from outside."""
    return mesh(head.level, head.CENTRE - head.SEMI_AXES, head.CENTRE + head.SEMI_AXES, HEAD_CELL)


def femur_surface() -> tuple[Floats, Ints]:
    """Return vertices, m, (V, 3), and faces, (F, 3), of the bone. Grooves are rounded by less than a grid cell."""
    low = np.min([np.minimum(part.start, part.end) - part.radius for part in femur.BONE], axis=0)
    high = np.max([np.maximum(part.start, part.end) + part.radius for part in femur.BONE], axis=0)
    return mesh(femur.distances, low, high, FEMUR_CELL)


SURFACES: dict[Phantom, Callable[[], tuple[Floats, Ints]]] = {HEAD: head_surface, FEMUR: femur_surface}
"""Phantom to the function that returns its surface."""


def mesh(field: Field, low: Floats, high: Floats, cell: float) -> tuple[Floats, Ints]:
    """Return the zero surface of a field within a box: vertices, m, (V, 3), and faces, (F, 3).

    Naive surface nets (S. F. F. Gibson, Constrained Elastic Surface Nets, MICCAI 1998): one vertex in each grid cell
    that the surface passes, and one square across each edge of the grid that it crosses. Then each vertex is moved onto
    the surface.

    Args:
        field: Implicit function, see `Field`.
        low: Corner of the box around the body with the smallest coordinates, m, (3,).
        high: Corner with the largest coordinates, m, (3,).
        cell: Size of a grid cell, m.
    """
    origin = low - MARGIN * cell
    shape = tuple((np.ceil((high - low) / cell).astype(int) + 2 * MARGIN + 1).tolist())
    values = field(origin + cell * np.moveaxis(np.indices(shape), 0, -1))
    cells, middles = _crossed_cells(values)
    number = np.full(np.array(shape) - 1, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    vertices = _to_surface(field, origin + cell * middles)
    return vertices.round(DECIMALS), _faces(values, number)


def ply(vertices: Floats, faces: Ints, comment: str) -> bytes:
    """Return a mesh as a binary PLY file.

    Args:
        vertices: Vertices, m, (V, 3).
        faces: Indices of the vertices of each triangle, (F, 3).
        comment: One line for the header, in ASCII.
    """
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment {comment}\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return header.encode() + vertices.astype("<f4").tobytes() + rows.tobytes()


def _crossed_cells(values: Floats) -> tuple[Ints, Floats]:
    """Return the cells that the surface passes, and the mean of its crossings of their edges, in cells, (V, 3) each."""
    inside = values < 0.0
    corners = np.stack([_shifted(inside, corner) for corner in _CORNERS])
    cells = np.argwhere(corners.any(axis=0) & ~corners.all(axis=0))
    at = np.stack([values[tuple((cells + corner).T)] for corner in _CORNERS])
    total, count = np.zeros((len(cells), 3)), np.zeros(len(cells))
    for a, b in _EDGES:
        crossed = (at[a] < 0.0) != (at[b] < 0.0)
        fraction = at[a] / np.where(crossed, at[a] - at[b], 1.0)  # linear interpolation between the corners
        total[crossed] += (_CORNERS[a] + fraction[:, None] * (_CORNERS[b] - _CORNERS[a]))[crossed]
        count += crossed
    return cells, cells + total / count[:, None]


def _shifted(inside: npt.NDArray[np.bool_], corner: Ints) -> npt.NDArray[np.bool_]:
    """Return the values at one corner of each cell."""
    x, y, z = (slice(int(c), size - 1 + int(c)) for c, size in zip(corner, inside.shape, strict=True))
    return inside[x, y, z]


def _faces(values: Floats, number: Ints) -> Ints:
    """Return two triangles per grid edge that crosses the surface, between the vertices of the four cells around it."""
    inside = values < 0.0
    quads = []
    for axis in range(3):
        first, second = (np.eye(3, dtype=int)[(axis + turn) % 3] for turn in (1, 2))
        edges = np.argwhere(np.diff(inside, axis=axis))
        around = [number[tuple((edges - shift).T)] for shift in (0 * first, first, first + second, second)]
        quad = np.stack(around, axis=1)
        outwards = inside[tuple(edges.T)]
        quads.append(np.where(outwards[:, None], quad, quad[:, ::-1]))
    corners = np.concatenate(quads)
    return np.concatenate((corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]))


def _to_surface(field: Field, points: Floats) -> Floats:
    """Move points onto the surface with Newton's steps along the gradient, m, (V, 3)."""
    steps = _GRADIENT_STEP * np.eye(3)
    for _ in range(_NEWTON_STEPS):
        differences = [field(points + step) - field(points - step) for step in steps]
        gradient = np.stack([difference / (2 * _GRADIENT_STEP) for difference in differences], axis=-1)
        squared = np.sum(gradient**2, axis=-1)
        points = points - (field(points) / squared)[:, None] * gradient
    return points
