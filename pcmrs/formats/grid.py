"""Grids of voxels, their limits, and the units and directions that files declare."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from pcmrs.formats.reading import refuse
from pcmrs.spatial import Floats

__all__ = ["Space", "Unit", "Volume"]

Unit = Literal["m", "mm"]
"""Unit of the lengths in a file."""
Space = Literal["RAS", "LPS"]
"""Axes of a file: to the right, anterior and superior, or to the left, posterior and superior."""
Role = Literal["planned", "digitized"]
Named = tuple[str, tuple[float, ...]]
"""A name and its point, RAS, m."""

METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
RAS_FROM = {"RAS": (1.0, 1.0, 1.0), "LPS": (-1.0, -1.0, 1.0)}


def as_ras(points: npt.ArrayLike, unit: str, space: str) -> Floats:
    """Return points as RAS and m.

    LPS (DICOM PS3.3 C.7.6.2.1.1) is RAS after half a turn about the superior axis: handedness stays.

    Args:
        points: Points (3,) or (N, 3) in `unit` and `space`.
        unit: Key of `METRES`.
        space: Key of `RAS_FROM`.
    """
    converted: Floats = np.asarray(points, dtype=float) * METRES[unit] * np.array(RAS_FROM[space])
    return converted


MAX_VOXELS = 200_000_000
"""512 x 512 x 760 voxels; 0.8 GB as 32-bit numbers."""
LEAST_EDGE, MOST_EDGE = 1e-5, 0.02
"""Limits of the edges of a voxel, m; beyond them, the declared unit must be wrong."""


@dataclass(frozen=True, eq=False)
class Volume:
    """Grey values on a grid.

    Attributes:
        values: float32, (I, J, K), finite.
        image_from_voxel: From indices (i, j, k, 1) of voxel centres to RAS, m, (4, 4); it need not be orthogonal.
    """

    values: npt.NDArray[np.float32]
    image_from_voxel: Floats


def check_size(path: Path, shape: Sequence[int]) -> None:
    """Refuse a volume of an impossible size, by its header alone.

    Args:
        path: The file.
        shape: Number of voxels along each axis.

    Raises:
        FileFormatError: It is not a volume of several slices, or too large.
    """
    if len(shape) != 3 or min(shape) < 2:
        refuse(path, f"has {' x '.join(map(str, shape))} voxels: give one volume of at least two slices.")
    voxels = math.prod(shape)
    if voxels > MAX_VOXELS:
        text = (
            f"has {' x '.join(map(str, shape))} voxels, {voxels / 1e6:.0f} million; the limit is {MAX_VOXELS / 1e6:.0f}"
        )
        refuse(path, f"{text} million. Crop it to the body, or resample it.", value=voxels, limit=MAX_VOXELS)


def check_grid(path: Path, image_from_voxel: Floats) -> None:
    """Refuse voxels without extent or of an impossible size.

    Args:
        path: The file.
        image_from_voxel: From indices (i, j, k, 1) of voxel centres to RAS, m, (4, 4).

    Raises:
        FileFormatError: An edge is too short or too long, or all edges lie in one plane.
    """
    axes = image_from_voxel[:3, :3]
    edges = np.linalg.norm(axes, axis=0)
    if not np.isfinite(image_from_voxel).all() or not (edges >= LEAST_EDGE).all() or not (edges <= MOST_EDGE).all():
        limits = f"{LEAST_EDGE * 1e3:g} to {MOST_EDGE * 1e3:g} mm"
        refuse(path, f"has voxels of {' x '.join(f'{edge * 1e3:.3g}' for edge in edges)} mm; the limits are {limits}.")
    if not abs(np.linalg.det(axes / edges)) > 1e-3:
        refuse(path, "has voxels whose edges lie in one plane; export it again.")
