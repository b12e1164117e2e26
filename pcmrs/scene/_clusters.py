"""Clusters of points in zones: objects that are large enough to be more than noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from pcmrs.spatial import Floats, Transform

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class BoxZone:
    """A watched box.

    Attributes:
        name: Name of the zone.
        base_from_box: Pose of its middle in the robot's base.
        size: Lengths of its edges along its own axes, m, (3,).
    """

    name: str
    base_from_box: Transform
    size: Floats

    def contains(self, points: Floats) -> Mask:
        """Return which points, in the robot's base, m, (n, 3), are in the box, (n,)."""
        turn, middle = self.base_from_box.rotation, self.base_from_box.translation
        return np.asarray((np.abs((points - middle) @ turn) <= self.size / 2.0).all(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """One object in a zone.

    Attributes:
        zone: Name of the zone.
        middle: Mean of its points in the robot's base, m, (3,).
        extent: Greatest length along an axis of the base, m.
        points: Number of its points.
    """

    zone: str
    middle: Floats
    extent: float
    points: int


def find_clusters(
    points: Floats, zones: Sequence[BoxZone], *, voxel: float, least_points: int, least_extent: float
) -> Iterator[Cluster]:
    """Yield the clusters in each zone: points in voxels that touch each other.

    Args:
        points: Points in the robot's base, m, (n, 3).
        zones: Watched zones.
        voxel: Edge of a voxel, m: points nearer than that are one object.
        least_points: Number of points from which a cluster counts.
        least_extent: Extent from which a cluster counts, m.
    """
    for zone in zones:
        inside = points[zone.contains(points)]
        if len(inside) < least_points:
            continue
        cells = np.floor(inside / voxel).astype(int)
        cells -= cells.min(axis=0)
        grid = np.zeros(cells.max(axis=0) + 1, dtype=bool)
        grid[tuple(cells.T)] = True
        labels, count = ndimage.label(grid, structure=np.ones((3, 3, 3)))
        own = labels[tuple(cells.T)]
        for number in range(1, count + 1):
            members = inside[own == number]
            extent = float(np.ptp(members, axis=0).max())
            if len(members) >= least_points and extent >= least_extent:
                yield Cluster(zone.name, members.mean(axis=0), extent, len(members))
