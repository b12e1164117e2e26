"""Triangle meshes of surfaces: STL, PLY and OBJ.

None of these formats declares its unit, few declare their directions: the caller declares both.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pcmrs.formats._ply import read_triangles
from pcmrs.formats.grid import Space, Unit, as_ras
from pcmrs.formats.reading import read_bytes, refuse
from pcmrs.spatial import Floats

__all__ = ["Mesh", "read_mesh"]

KINDS = (".stl", ".ply", ".obj")
MAX_MESH_BYTES = 64 * 1024 * 1024
"""Limit of a file: about a million triangles."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles.

    Attributes:
        vertices: RAS, m, (V, 3).
        faces: Indices of the corners, counter-clockwise seen from outside, (F, 3).
    """

    vertices: Floats
    faces: npt.NDArray[np.int64]


def read_mesh(path: Path, unit: Unit, space: Space) -> Mesh:
    """Return the mesh of a file, with coinciding vertices merged.

    Args:
        path: The file.
        unit: Its unit of length.
        space: Its directions.

    Raises:
        FileFormatError: It cannot be read, is too long, of another kind, or has no triangle, or invalid numbers.
    """
    kind = path.suffix.lower()
    if kind not in KINDS:
        refuse(path, f"is not a mesh that can be read: its suffix must be one of {', '.join(KINDS)}.")
    vertices, faces = _load(path, read_bytes(path, MAX_MESH_BYTES), kind.removeprefix("."))
    if not len(faces):
        refuse(path, "holds no triangles.")
    if np.shape(vertices)[1:] != (3,) or np.shape(faces)[1:] != (3,):
        refuse(path, "has corners without three coordinates, or faces without three corners; export the mesh again.")
    if not np.isfinite(vertices).all():
        refuse(path, "holds a corner that is not finite; export the mesh again.")
    if not 0 <= faces.min() <= faces.max() < len(vertices):
        refuse(path, "has a triangle with a corner that it does not hold; export the mesh again.")
    vertices, faces = _merged(vertices, faces)
    return Mesh(as_ras(vertices, unit, space), faces)


def _load(path: Path, raw: bytes, kind: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Corners and faces as the file has them."""
    found = read_triangles(raw) if kind == "ply" else None
    if found is not None:
        return found

    import trimesh  # takes longer to load than all else that a process of a cell needs

    try:
        loaded = trimesh.load_mesh(io.BytesIO(raw), file_type=kind, process=False, skip_materials=True)
        return np.asarray(loaded.vertices), np.asarray(loaded.faces)
    except ImportError:  # for a truncated binary file, the library imports a module that guesses encodings
        refuse(path, f"is not a mesh in {kind.upper()}: it is neither a whole binary file nor text.")
    except Exception as error:  # its parsers raise exceptions of any kind
        refuse(path, f"is not a mesh in {kind.upper()}: {type(error).__name__}: {error}")


def _merged(vertices: npt.NDArray[Any], faces: npt.NDArray[Any]) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Return the same triangles with each corner once, in the file's order, and without corners of no triangle."""
    _, first, number = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    kept, position = np.unique(first[number.reshape(-1)][faces], return_inverse=True)
    return vertices[kept].astype(float), position.reshape(faces.shape)
