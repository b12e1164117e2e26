"""Coverage of a surface by touched points: in which region more points would lower the predicted TRE most.

The information of landmarks, offsets and points adds up, and its inverse is the covariance of the registration
(`_surface_fit` has the formulas). Points still to be touched enter by their expected information. Of n points that are
spread evenly over a region with the area A it is ``n / A`` times the integral of ``row^T row / sigma^2`` over the
region. This is optimal design of an experiment with the variance at the target as its criterion (V. V. Fedorov, Theory
of Optimal Experiments, 1972). D. A. Simon, Fast and Accurate Shape-Based Registration, PhD thesis, Carnegie Mellon
University 1996, designs registrations in this way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from pcmrs.registration._surface_fit import (
    OffsetPrior,
    SurfaceProblem,
    checked_problem,
    inverse,
    members_of,
    trimming_efficiency,
)
from pcmrs.spatial import Floats, Transform

__all__ = ["MORE_POINTS", "REGIONS", "Region", "RegionCoverage", "SurfaceCoverage", "surface_coverage"]

Region = Literal["front", "back", "left", "right", "top"]
"""Name of a region of the surface."""
REGIONS: dict[Region, tuple[float, float, float]] = {
    "front": (0.0, 1.0, 0.0),
    "back": (0.0, -1.0, 0.0),
    "left": (-1.0, 0.0, 0.0),
    "right": (1.0, 0.0, 0.0),
    "top": (0.0, 0.0, 1.0),
}
"""Region to the direction that its outward normals have most of, in an image whose axes are right, anterior and
superior. What faces down cannot be touched."""
PLACES: dict[Region, str] = {
    "front": "at the front",
    "back": "at the back",
    "left": "on the left side",
    "right": "on the right side",
    "top": "on top",
}
MORE_POINTS = 20
"""Number of further points whose effect is predicted: a minute of touching."""
LEAST_SHARE = 0.01
"""Share of the area below which a region is not recommended: nobody can spread points there."""


@dataclass(frozen=True)
class RegionCoverage:
    """Points in one region, and the effect of more of them.

    Attributes:
        region: Name of the region.
        points: Number of points that have been touched there.
        tre: Predicted rms TRE at the target with `SurfaceCoverage.more` further points spread over the region, m.
    """

    region: Region
    points: int
    tre: float


@dataclass(frozen=True)
class SurfaceCoverage:
    """Coverage of a surface by touched points.

    Attributes:
        tre: Predicted rms TRE at the target with the landmarks and the points so far, m.
        more: Number of further points whose effect is predicted.
        regions: Regions that the surface has, that with the lowest `RegionCoverage.tre` first.
    """

    tre: float
    more: int
    regions: tuple[RegionCoverage, ...]

    @property
    def advice(self) -> str:
        """What helps most, such as ``20 points at the back: 1.4 → 0.8 mm``; empty if the surface has no region."""
        if not self.regions:
            return ""
        best = self.regions[0]
        return f"{self.more} points {PLACES[best.region]}: {self.tre * 1000:.1f} → {best.tre * 1000:.1f} mm"


def surface_coverage(
    registration: Transform,
    landmarks_image: npt.ArrayLike,
    landmarks_body_ref: npt.ArrayLike,
    sigma: float,
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    points_body_ref: npt.ArrayLike,
    sigma_surface: float,
    target: npt.ArrayLike,
    trim: float = 0.9,
    offsets: Sequence[OffsetPrior] = (),
    more: int = MORE_POINTS,
) -> SurfaceCoverage:
    """Predict the TRE with the points so far, and with more points in each region.

    It predicts what `refine_with_surface` would state, and takes no account of what that refuses.

    Args:
        registration: ``body_ref_from_image`` by the landmarks, or refined.
        landmarks_image: Landmarks as planned, in the image, m, (N, 3).
        landmarks_body_ref: Landmarks as digitized, in body_ref and in the same order, m, (N, 3).
        sigma: Standard deviation of a digitized landmark per axis, m.
        vertices: Vertices of the surface in the image, m, (V, 3).
        faces: Triangles of the surface, counter-clockwise seen from outside, (F, 3).
        points_body_ref: Points touched on the surface so far, in body_ref, m, (K, 3); K may be 0.
        sigma_surface: Standard deviation of a touched point along the normal, m.
        target: Point in the image at which the error is predicted, m, (3,).
        trim: Share of the points that is used.
        offsets: Priors of the offsets that are estimated.
        more: Number of further points in one region.

    Raises:
        GeometryError: Shapes are wrong, numbers are not finite, or a standard deviation, `trim` or a prior is out of
            range.
        DegeneratePointsError: The landmarks do not determine a rotation.
        MirroredPointsError: A mirror image fits the landmarks far better than any rotation.
    """
    problem = checked_problem(
        registration,
        landmarks_image,
        landmarks_body_ref,
        sigma,
        vertices,
        faces,
        points_body_ref,
        sigma_surface,
        target,
        trim,
        offsets,
    )
    near, normals = problem.surface.near(registration.inverse() @ problem.points_body_ref)
    touched = problem.surface_rows(registration, near, normals, problem.members)
    share = problem.trim * trimming_efficiency(problem.trim) / problem.sigma_surface**2
    known = problem.fixed_information(registration) + share * touched.T @ touched
    counts = np.bincount(_region_indices(normals), minlength=len(REGIONS) + 1)
    added = _expected_information(problem, registration)
    regions = [
        RegionCoverage(
            region, int(counts[index]), problem.tre(registration, inverse(known + more * share * added[region]))
        )
        for index, region in enumerate(REGIONS)
        if region in added
    ]
    regions.sort(key=lambda each: each.tre)
    return SurfaceCoverage(problem.tre(registration, inverse(known)), more, tuple(regions))


def _expected_information(problem: SurfaceProblem, registration: Transform) -> dict[Region, Floats]:
    """Return the mean of ``row^T row`` over each region that the surface has, (6 + G, 6 + G)."""
    middles, normals, areas = problem.surface.facets()
    members = members_of(problem.priors, middles, problem.middle)
    rows = problem.surface_rows(registration, middles, normals, members)
    indices = _region_indices(normals)
    found: dict[Region, Floats] = {}
    for index, region in enumerate(REGIONS):
        inside = indices == index
        area = areas[inside].sum()
        if area > LEAST_SHARE * areas.sum():
            found[region] = np.einsum("k,ki,kj->ij", areas[inside], rows[inside], rows[inside]) / area
    return found


def _region_indices(normals: Floats) -> npt.NDArray[np.int64]:
    """Return the index of each normal's region, (K,); the number of regions if it faces down."""
    directions = np.array([*REGIONS.values(), (0.0, 0.0, -1.0)])
    return np.asarray(np.argmax(normals @ directions.T, axis=1), dtype=np.int64)
