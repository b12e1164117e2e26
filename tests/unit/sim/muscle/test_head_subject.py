"""The subject of a head: where its scalp is nearest."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs_sim.head import CENTRE, level, outward_normal, surface_point
from pcmrs_sim.muscle.head_subject import closest_on_scalp
from tests.support.trials import examples


@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.3, 1)), st.floats(-0.005, 0.01))
@examples(25)
def test_the_nearest_point_of_the_scalp_is_the_nearest(direction: tuple[float, float, float], height: float) -> None:
    foot = surface_point(direction)
    point = foot + height * outward_normal(foot) + np.array((0.001, -0.002, 0.0005))
    found, normal = (rows[0] for rows in closest_on_scalp(point[None]))
    tangents = np.linalg.svd(normal[None])[2][1:]
    steps = 1e-4 * np.stack([np.cos(np.arange(8)), np.sin(np.arange(8))], axis=1) @ tangents
    beside = np.array([surface_point(found + step - CENTRE) for step in steps])
    assert level(found) == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(found - point) <= np.linalg.norm(beside - point, axis=1).min() + 1e-9
    assert normal == pytest.approx(outward_normal(found))
