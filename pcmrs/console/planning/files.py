"""Files that a person gives to the page: read in a process of their own, so that the page goes on come what may."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pcmrs.errors import PcmrsError
from pcmrs.formats.landmarks import Landmarks, read_landmarks
from pcmrs.formats.mesh import KINDS, Mesh, read_mesh
from pcmrs.formats.reading import refuse
from pcmrs.formats.skin import skin_of
from pcmrs.formats.units import Space, Unit
from pcmrs.formats.volume import read_volume

T = TypeVar("T")

LARGEST = 1_000_000_000
"""Of all files of one upload, bytes."""
MOST_FILES = 900
"""Of one upload; the library that takes uploads has its own limit at 1000."""
MOST_FACES = 300_000
"""A browser shows no more in time."""
LEAST_EXTENT, MOST_EXTENT = 0.02, 2.0
"""Of a surface along its longest side, m: outside of these the unit is another one."""
PATIENCE = 300.0
"""For one file, s."""


async def read_surface(path: Path, unit: Unit, space: Space, threshold: float | None) -> Mesh:
    """The surface in a mesh, or that of the body in a volume; a folder is a DICOM series.

    Args:
        path: File or folder.
        unit: Of a mesh, which does not say it.
        space: The same.
        threshold: Grey value of the surface in a volume; None for one that is worked out.

    Raises:
        PcmrsError: It cannot be read, or is no surface to plan on.
    """
    return await _apart(_surface, path, unit, space, threshold)


async def read_points(path: Path) -> Landmarks:
    """The points of a file of landmarks. Raises `PcmrsError`."""
    return await _apart(_points, path)


async def _apart(function: Callable[..., T], path: Path, *arguments: Any) -> T:
    """Calls a function in a process of its own, which ends with the call. Raises `PcmrsError`."""
    spawning = get_context("spawn")
    ours, theirs = spawning.Pipe(duplex=False)
    process = spawning.Process(target=_tell, args=(theirs, function, path, *arguments), daemon=True)
    process.start()
    theirs.close()
    try:
        async with asyncio.timeout(PATIENCE):
            found: T | PcmrsError = await asyncio.to_thread(ours.recv)
    except TimeoutError:
        refuse(path, f"took more than {PATIENCE:g} s to read; give a smaller one.", limit=PATIENCE)
    except EOFError:
        refuse(path, "ended the process that read it, perhaps for want of memory; give a smaller one.")
    finally:
        process.kill()  # which ends the thread, too
        process.join()
    if isinstance(found, PcmrsError):
        raise found
    return found


def _tell(channel: Connection, function: Callable[..., object], *arguments: Any) -> None:
    """What a function returns or refuses, to another process."""
    try:
        channel.send(function(*arguments))
    except PcmrsError as error:
        channel.send(error)


def _surface(path: Path, unit: Unit, space: Space, threshold: float | None) -> Mesh:
    mesh = read_mesh(path, unit, space) if path.suffix.lower() in KINDS else skin_of(read_volume(path), threshold)
    if len(mesh.faces) > MOST_FACES:
        text = f"has {len(mesh.faces)} triangles; the limit is {MOST_FACES}. Simplify it, as in 3D Slicer or MeshLab."
        refuse(path, text, value=len(mesh.faces), limit=MOST_FACES)
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    if not LEAST_EXTENT <= extent <= MOST_EXTENT:
        text = f"would be {extent:.3g} m long; {LEAST_EXTENT:g} to {MOST_EXTENT:g} m are taken. Give its other unit."
        refuse(path, text, value=extent)
    return mesh


def _points(path: Path) -> Landmarks:
    found = read_landmarks(path)
    if found.role == "digitized":
        refuse(path, "holds digitized landmarks, which are in body_ref; give planned ones, which are in the image.")
    return found
