"""The untrusted process that reads one uploaded file: see `pcmrs.console.planning.files`.

The request comes on standard input, the answer goes to standard output, both as MessagePack, which carries values and
never code.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from pcmrs.console.planning.confined import confine
from pcmrs.errors import PcmrsError
from pcmrs.formats.grid import Role, Space, Unit
from pcmrs.formats.landmarks import Landmarks, read_landmarks
from pcmrs.formats.mesh import KINDS, Mesh, read_mesh
from pcmrs.formats.reading import refuse
from pcmrs.formats.skin import skin_of
from pcmrs.formats.volume import read_volume

MOST_FACES: Final = 300_000
"""Limit of faces that a browser can show in time."""
MOST_POINTS: Final = 10_000
LEAST_EXTENT, MOST_EXTENT = 0.02, 2.0
"""Limits of a surface's longest side, m: beyond them, the unit must be wrong."""

Point = tuple[float, float, float]


class SurfaceRequest(msgspec.Struct, frozen=True, tag="surface"):
    """Request to read a surface; `memory` is in bytes, `seconds` is processor time."""

    path: str
    memory: int
    seconds: int
    unit: Unit
    space: Space
    threshold: float | None


class PointsRequest(msgspec.Struct, frozen=True, tag="points"):
    """Request to read points."""

    path: str
    memory: int
    seconds: int


class SurfaceAnswer(msgspec.Struct, frozen=True, tag="surface"):
    """A surface: float64 and int64, row by row, in the machine's byte order."""

    vertices: bytes
    faces: bytes


class PointsAnswer(msgspec.Struct, frozen=True, tag="points"):
    """Points, m."""

    names: tuple[str, ...]
    points: tuple[Point, ...]
    role: Role | None


class RefusalAnswer(msgspec.Struct, frozen=True, tag="refused"):
    """Reason why the file cannot be used."""

    text: str


ImportRequest = SurfaceRequest | PointsRequest
ImportAnswer = SurfaceAnswer | PointsAnswer | RefusalAnswer


def main() -> None:
    """Answer the request on standard input."""
    sys.dont_write_bytecode = True
    request = msgspec.msgpack.decode(sys.stdin.buffer.read(), type=ImportRequest)
    confine(request.memory, request.seconds)
    try:
        answer = _read_requested(request)
    except PcmrsError as error:
        answer = RefusalAnswer(error.text)
    sys.stdout.buffer.write(msgspec.msgpack.encode(answer))
    sys.stdout.buffer.flush()


def _read_requested(request: ImportRequest) -> ImportAnswer:
    """Read the requested file.

    Raises:
        PcmrsError: It cannot be used.
    """
    path = Path(request.path)
    if isinstance(request, PointsRequest):
        found = read_points(path)
        return PointsAnswer(found.names, tuple(tuple(point) for point in found.points.tolist()), found.role)
    mesh = read_surface(path, request.unit, request.space, request.threshold)
    return SurfaceAnswer(mesh.vertices.astype(np.float64).tobytes(), mesh.faces.astype(np.int64).tobytes())


def read_surface(path: Path, unit: Unit, space: Space, threshold: float | None) -> Mesh:
    """Return the surface in a mesh, or that of the body in a volume.

    Args:
        path: File or folder.
        unit: Unit of a mesh.
        space: Directions of a mesh.
        threshold: Grey value of the surface in a volume; None for a computed one.

    Raises:
        PcmrsError: It cannot be read, or is too large.
    """
    mesh = read_mesh(path, unit, space) if path.suffix.lower() in KINDS else skin_of(read_volume(path), threshold)
    if len(mesh.faces) > MOST_FACES:
        text = f"has {len(mesh.faces)} triangles; the limit is {MOST_FACES}. Simplify it, as in 3D Slicer or MeshLab."
        refuse(path, text, value=len(mesh.faces), limit=MOST_FACES)
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    if not LEAST_EXTENT <= extent <= MOST_EXTENT:
        text = f"would be {extent:.3g} m long; the limits are {LEAST_EXTENT:g} and {MOST_EXTENT:g} m. Change the unit."
        refuse(path, text, value=extent)
    return mesh


def read_points(path: Path) -> Landmarks:
    """Return the points of a file of landmarks.

    Raises:
        PcmrsError: It cannot be read, or has digitized landmarks, or too many.
    """
    found = read_landmarks(path)
    if found.role == "digitized":
        refuse(path, "holds digitized landmarks, which are in body_ref; give planned ones, which are in the image.")
    if len(found.names) > MOST_POINTS:
        refuse(path, f"holds {len(found.names)} points; the limit is {MOST_POINTS}.", limit=MOST_POINTS)
    return found


if __name__ == "__main__":
    main()
