"""The true surfaces of the phantoms as triangle meshes, in the image frame (RAS, m).

These are phantoms, made of formulas: what a segmented scan would be for a patient, without its errors.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats
from pcmrs_sim import femur, head

Field = Callable[[Floats], Floats]
"""Of points (..., 3): negative inside, zero on the surface, positive outside; (...,)."""
Ints = npt.NDArray[np.int64]
HEAD_CELL = 0.0048  # m
FEMUR_CELL = 0.0024  # m
MARGIN = 2  # cells around the body
DECIMALS = 6  # of m: what the file says is the same on every machine
_PROBE = 1e-6  # m: for the gradient
_CORNERS = np.array(list(np.ndindex(2, 2, 2)))
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]


def head_surface() -> tuple[Floats, Ints]:
    """Vertices, m, (V, 3), and faces (F, 3) of the scalp, counter-clockwise seen from outside."""
    return mesh(head.level, head.CENTRE - head.SEMI_AXES, head.CENTRE + head.SEMI_AXES, HEAD_CELL)


def femur_surface() -> tuple[Floats, Ints]:
    """The same of the bone; its grooves are rounded by less than a cell."""
    low = np.min([np.minimum(part.start, part.end) - part.radius for part in femur.BONE], axis=0)
    high = np.max([np.maximum(part.start, part.end) + part.radius for part in femur.BONE], axis=0)
    return mesh(femur.distances, low, high, FEMUR_CELL)


def mesh(field: Field, low: Floats, high: Floats, cell: float) -> tuple[Floats, Ints]:
    """The zero surface of a field within a box.

    Naive surface nets (S. F. F. Gibson, Constrained Elastic Surface Nets, MICCAI 1998): one vertex in each cell that
    the surface passes, one square across each edge of the grid that it crosses; then each vertex goes to the surface.

    Args:
        field: See `Field`.
        low: Corner of the box around the body, m, (3,).
        high: The opposite corner, m, (3,).
        cell: Size of a cell of the grid, m.
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
    """The mesh as a binary PLY file; m."""
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment {comment}\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return header.encode() + vertices.astype("<f4").tobytes() + rows.tobytes()


def _crossed_cells(values: Floats) -> tuple[Ints, Floats]:
    """Indices of the cells that the surface passes, (V, 3), and the mean of its crossings of their edges, in cells."""
    inside = values < 0.0
    corners = np.stack([_shifted(inside, corner) for corner in _CORNERS])
    cells = np.argwhere(corners.any(axis=0) & ~corners.all(axis=0))
    at = np.stack([values[tuple((cells + corner).T)] for corner in _CORNERS])
    total, count = np.zeros((len(cells), 3)), np.zeros(len(cells))
    for a, b in _EDGES:
        crossed = (at[a] < 0.0) != (at[b] < 0.0)
        part = at[a] / np.where(crossed, at[a] - at[b], 1.0)
        total[crossed] += (_CORNERS[a] + part[:, None] * (_CORNERS[b] - _CORNERS[a]))[crossed]
        count += crossed
    return cells, cells + total / count[:, None]


def _shifted(inside: npt.NDArray[np.bool_], corner: Ints) -> npt.NDArray[np.bool_]:
    x, y, z = (slice(int(c), size - 1 + int(c)) for c, size in zip(corner, inside.shape, strict=True))
    return inside[x, y, z]


def _faces(values: Floats, number: Ints) -> Ints:
    """Two triangles for each edge of the grid with one end inside, between the vertices of the four cells around it."""
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
    """Newton's steps along the gradient."""
    for _ in range(4):
        steps = _PROBE * np.eye(3)
        gradient = np.stack([(field(points + step) - field(points - step)) / (2 * _PROBE) for step in steps], axis=-1)
        squared = np.sum(gradient**2, axis=-1)
        points = points - (field(points) / squared)[:, None] * gradient
    return points
