"""Files that a person uploads, each read in its own process, so that the page keeps running whatever happens.

That process has limits and no network, and its answer is checked as untrusted input: a file may have
taken over the process.
"""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path
from typing import Final, NoReturn

import msgspec
import numpy as np

from pcmrs.console.planning.importer import (
    MOST_FACES,
    MOST_POINTS,
    ImportAnswer,
    ImportRequest,
    PointsAnswer,
    PointsRequest,
    RefusalAnswer,
    SurfaceAnswer,
    SurfaceRequest,
)
from pcmrs.errors import FileFormatError
from pcmrs.formats.grid import Space, Unit
from pcmrs.formats.landmarks import Landmarks
from pcmrs.formats.mesh import Mesh
from pcmrs.formats.reading import refuse
from pcmrs.killing import kill_and_wait

LARGEST = 1_000_000_000
"""Limit of all files of one upload, bytes."""
MOST_FILES = 900
"""Limit of files in one upload; the library for uploads has its own limit of 1000."""
PATIENCE = 300.0
"""Longest time to read one file, s."""
MEMORY = 8 * 2**30
"""Address space of the process that reads one file, bytes: for a volume of `LARGEST` and its surface."""

_CHILD: Final = (sys.executable, "-m", "pcmrs.console.planning.importer")
_ONE_THREAD: Final = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Landlock confines the thread that asks for it, so that there must be no other."""
_LONGEST_ANSWER: Final = 2 * MOST_FACES * 3 * 8 + 2**20
"""Bytes: a closed surface has about half as many vertices as triangles, an open one not many more."""


async def read_surface(path: Path, unit: Unit, space: Space, threshold: float | None) -> Mesh:
    """Return the surface in a mesh, or that of the body in a volume; a folder is a DICOM series.

    Args:
        path: File or folder.
        unit: Unit of a mesh, which does not declare it.
        space: Directions of a mesh, which does not declare them.
        threshold: Grey value of the surface in a volume; None for a computed one.

    Raises:
        PcmrsError: It cannot be read, or is not a surface to plan on.
    """
    answer = await _ask(path, SurfaceRequest(str(path), MEMORY, int(PATIENCE), unit, space, threshold))
    return surface_in(path, answer)


async def read_points(path: Path) -> Landmarks:
    """Return the points of a file of landmarks.

    Raises:
        PcmrsError: It cannot be read, or has no points to plan with.
    """
    answer = await _ask(path, PointsRequest(str(path), MEMORY, int(PATIENCE)))
    if not isinstance(answer, PointsAnswer):
        _refuse_answer(path)
    points = np.array(answer.points, dtype=float).reshape(-1, 3)
    if not (len(points) == len(set(answer.names)) <= MOST_POINTS and np.isfinite(points).all()):
        _refuse_answer(path)
    return Landmarks(answer.names, points, answer.role)


def surface_in(path: Path, answer: ImportAnswer) -> Mesh:
    """Return the surface in an answer.

    Args:
        path: The file, for errors.
        answer: Answer of the reading process.

    Raises:
        FileFormatError: It has no valid surface.
    """
    if not isinstance(answer, SurfaceAnswer) or len(answer.vertices) % 24 or len(answer.faces) % 24:
        _refuse_answer(path)
    vertices = np.frombuffer(answer.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.frombuffer(answer.faces, dtype=np.int64).reshape(-1, 3)
    ours = 0 < len(faces) <= MOST_FACES and faces.min() >= 0 and faces.max() < len(vertices)
    if not (ours and np.isfinite(vertices).all()):
        _refuse_answer(path)
    return Mesh(vertices, faces)


async def _ask(path: Path, request: ImportRequest) -> ImportAnswer:
    """Return the answer of a new process, which ends with this call.

    Raises:
        PcmrsError: The file cannot be read.
    """
    pipe = asyncio.subprocess.PIPE
    # A file that has taken over the process must not write to the terminal or log of this one.
    process = await asyncio.create_subprocess_exec(
        *_CHILD, stdin=pipe, stdout=pipe, stderr=asyncio.subprocess.DEVNULL, env=os.environ | _ONE_THREAD
    )
    try:
        async with asyncio.timeout(PATIENCE):
            answer = await _read_answer(process, msgspec.msgpack.encode(request))
    except TimeoutError:
        refuse(path, f"took more than {PATIENCE:g} s to read; give a smaller one.", limit=PATIENCE)
    finally:
        await kill_and_wait(process)
    if not answer:
        refuse(path, "ended the process that read it, perhaps for lack of memory; give a smaller one.")
    try:
        found: ImportAnswer = msgspec.msgpack.decode(answer, type=ImportAnswer)
    except msgspec.MsgspecError:
        _refuse_answer(path)
    if isinstance(found, RefusalAnswer):
        raise FileFormatError(found.text, file=str(path))
    return found


async def _read_answer(process: asyncio.subprocess.Process, request: bytes) -> bytes:
    """Return the output of the process, up to a limit; nothing if it ends earlier."""
    assert process.stdin is not None  # for mypy: they were requested
    assert process.stdout is not None
    process.stdin.write(request)
    process.stdin.close()
    try:
        return await process.stdout.readexactly(_LONGEST_ANSWER + 1)
    except asyncio.IncompleteReadError as ended:
        return ended.partial


def _refuse_answer(path: Path) -> NoReturn:
    refuse(path, "gave neither a surface nor points when it was read; check the file.")
