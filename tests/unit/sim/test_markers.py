"""The tracked bodies can be measured and told apart by their spheres alone."""

from itertools import combinations

import numpy as np
import pytest

from pcmrs_sim.markers import MARKER_BODIES
from pcmrs_sim.tracker_faults import BODIES


def test_every_tracked_body_has_spheres() -> None:
    assert tuple(MARKER_BODIES) == BODIES


@pytest.mark.parametrize("name", BODIES)
def test_spheres_lie_in_their_plane_around_the_origin(name: str) -> None:
    markers = MARKER_BODIES[name]
    assert np.abs(markers.positions.mean(axis=0)).max() < 1e-12
    assert np.abs((markers.plane.inverse() @ markers.positions)[:, 2]).max() < 1e-12
    assert np.linalg.norm(markers.positions, axis=1).max() == pytest.approx(0.05, abs=0.01)
    assert np.linalg.svd(markers.positions, compute_uv=False)[1] > 0.04, "they are not in a line"


def test_no_two_distances_of_spheres_are_alike() -> None:
    """A tracker pairs spheres by their distances; it separates those that differ by a millimetre."""
    distances = [
        float(np.linalg.norm(one - other))
        for markers in MARKER_BODIES.values()
        for one, other in combinations(markers.positions, 2)
    ]
    for name, markers in MARKER_BODIES.items():
        own = sorted(float(np.linalg.norm(a - b)) for a, b in combinations(markers.positions, 2))
        assert np.diff(own).min() > 1e-3, name
    assert len(distances) == 24
